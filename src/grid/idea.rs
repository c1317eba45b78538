//! What our mapper adds to the paper's, idea by idea, so that the worth of each can be measured.

use serde::{Deserialize, Serialize};

/// One idea, which can be left out ([`VisaggeSettings::without`](super::visagge::VisaggeSettings::without)).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Idea {
    /// What came where a beam had passed is solid only if it was seen from a wide range of angles, or for a while.
    Newcomers,
    /// What beams went past shortly before, be it without return, is a newcomer too.
    Silences,
    /// Where the robot has been, what has come since is somebody, unless it glints or has stayed for longer than people do.
    Driven,
    /// What has come as a whole and is no larger than a person is solid only if it has stayed for longer than people do.
    Visitors,
    /// What was solid and was missed to the end has been taken away.
    TakenAway,
    /// So has what was seen over more than glass is, and too bright for dust, though it is flat; needs intensities.
    Diffuse,
    /// What was seen often, for long and from many directions is there, though it was missed in between.
    Lasting,
    /// Of what was missed, only flat surfaces that are seen about their normal are shown; without, all of it.
    Surfaces,
    /// A surface is sought among what was seen from the very same direction first.
    PlanesFirst,
    /// A single glint on a broad surface is no random reading.
    Singles,
    /// Long straight surfaces may be seen farther off their normal.
    LongSurfaces,
    /// What is missed may be round, too: seen about the normal of a circle in each of its cells.
    Round,
    /// What is long and straight is shown wherever it was seen from, if it was seen often and may be no image.
    Oblique,
    /// Of a patch that is uneven, what lies right before or behind is left out of the surface.
    Trimmed,
    /// Nothing else may be seen right before or behind a surface.
    Clutter,
    /// Cells in narrow gaps of what is shown are shown.
    Gaps,
    /// A surface is more than one cell: what is not solid is not shown where nothing beside it is.
    Alone,
    /// Images are not shown.
    Images,
    /// What was never missed may show something else too, if it glints, or if a beam had crossed it before it was first seen.
    Unmissed,
    /// Glass reflects only as much as physics allows; without, all that is explained is an image.
    Fresnel,
    /// An image in glass is no brighter than glass reflects; needs intensities.
    Bright,
    /// Where nearly all that is seen through a surface is explained, it is opaque, and reflects all.
    Opacity,
    /// Only an original right where it is sought tells that a surface is opaque, and only where there is none far around, that it is not.
    Tells,
    /// The plane that something is mirrored in is drawn through all that goes on along it, walls beside it included.
    LongPlanes,
    /// A wall that runs straight at a surface does not tell whether that is opaque: its image would lie on itself.
    Symmetry,
    /// An image must be explained from its second range of view angles too.
    SecondRange,
    /// What is seen from some directions only is no original of an image that it would be seen in from others.
    Originals,
    /// What a wall hides from a surface is no original of an image in it.
    Hidden,
    /// What was seen for less than a second and never missed may be somebody who walks by in a mirror: it does not tell that a surface is
    /// seen through.
    PassersBy,
    /// What is seen through a surface, or in it, in some scans only is not shown where it may be somebody who walks by in a mirror.
    Glimpses,
    /// Whatever is seen behind a wall that has always stood there is an image.
    Walls,
    /// What has returned glints, brighter than anything diffuse, is a surface seen about its normal; needs intensities.
    Glints,
    /// What glints is not contradicted from farther away than it was seen from, but where it would glint.
    Outshone,
    /// Of two things that were seen in a cell from different angles, only the one that has gone is forgotten.
    Apart,
    /// What has not glinted though it could is a surface only where it is broader than anybody, or has stayed for longer than people do.
    Dull,
    /// Surfaces are drawn one cell thick.
    Thin,
    /// Diagonal ones too: corners are cut.
    Diagonals,
    /// What glints right before a wall is a pane, and is drawn beside the wall.
    Panes,
    /// The two faces of a thin wall are drawn both.
    Faces,
}

impl Idea {
    /// All of them.
    pub const ALL: [Idea; 39] = [
        Idea::Newcomers,
        Idea::Silences,
        Idea::Driven,
        Idea::Visitors,
        Idea::TakenAway,
        Idea::Diffuse,
        Idea::Lasting,
        Idea::Surfaces,
        Idea::PlanesFirst,
        Idea::Singles,
        Idea::LongSurfaces,
        Idea::Round,
        Idea::Oblique,
        Idea::Trimmed,
        Idea::Clutter,
        Idea::Gaps,
        Idea::Alone,
        Idea::Images,
        Idea::Unmissed,
        Idea::Fresnel,
        Idea::Bright,
        Idea::Opacity,
        Idea::Tells,
        Idea::LongPlanes,
        Idea::Symmetry,
        Idea::SecondRange,
        Idea::Originals,
        Idea::Hidden,
        Idea::PassersBy,
        Idea::Glimpses,
        Idea::Walls,
        Idea::Glints,
        Idea::Outshone,
        Idea::Apart,
        Idea::Dull,
        Idea::Thin,
        Idea::Diagonals,
        Idea::Panes,
        Idea::Faces,
    ];
}
