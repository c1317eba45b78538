//! The map that lives on: a file that holds all that the grid knows, so that the next run goes on in the same map.
//!
//! Magic, version, length and CRC-32 (little-endian, [`HEADER`] bytes), then [`SavedMap`] in postcard's format within a zstd
//! frame. The file is whole or the one before: it is written under another name, synced and renamed. What it holds of the
//! grid is [`SavedGrid`]; the matching maps of the localizer are made of it anew.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::grid::saved::{BadGrid, SavedGrid};
use crate::mapper::{MapperKind, MapperSettings};

/// First bytes of the file.
const MAGIC: [u8; 8] = *b"VISAGGE\n";
/// Version of the format; grows whenever [`SavedMap`] changes.
pub const VERSION: u32 = 6;
/// Length of all before the zstd frame: magic 8, version 4, length of the content 8, CRC-32 of all other bytes 4.
pub const HEADER: usize = 24;
/// No content is longer (bytes): a grid of a square kilometre with evidence in every tenth cell.
const LONGEST: u64 = 4 << 30;
/// Level of the compression: a fifth of the size in a tenth of a second for 20 MB; higher levels win a tenth more.
const LEVEL: i32 = 3;
/// What a file is called that a fresh start found in its place.
pub const FORMER: &str = "former";

/// What is kept from run to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedMap {
    /// Program and version that saved it.
    pub program: String,
    /// Scans that are in the map, of all runs.
    pub scans: u64,
    /// The grid.
    pub grid: SavedGrid,
}

/// Why bytes are no saved map.
#[derive(Debug, Error)]
pub enum Damage {
    /// Something else.
    #[error("this is no map that visagged saved: it does not begin with \"VISAGGE\"")]
    Foreign,
    /// Of another version.
    #[error(
        "it was saved in format {0}, and this version reads format {VERSION}: use the version that saved it"
    )]
    Version(u32),
    /// Cut off, or bytes have changed.
    #[error(
        "it is damaged or cut short: the checksum of its {len} bytes is {got:08x}, and {want:08x} is wanted"
    )]
    Checksum {
        /// Its length (bytes).
        len: usize,
        /// What it should be.
        want: u32,
        /// What it is.
        got: u32,
    },
    /// Shorter than what comes first.
    #[error("it is cut short: it has {0} bytes of the {HEADER} that come first")]
    Short(usize),
    /// The sum is right and the content is not.
    #[error("its content cannot be read ({0}), though its checksum is right: whatever wrote it has a fault")]
    Content(String),
    /// The content is no grid.
    #[error("its grid cannot be used ({0}), though its checksum is right: whatever wrote it has a fault")]
    Grid(#[from] BadGrid),
}

/// Why a run cannot go on in a saved map. Nothing has been overwritten.
#[derive(Debug, Error)]
pub enum LoadError {
    /// The system said no.
    #[error("the map {}: {error}; see to it, or name another file", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// It is no map, or a damaged one.
    #[error(
        "the map {}: {damage}. It is left as it is; put a good copy in its place, name another file, or begin an empty \
         map with --fresh",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        damage: Damage,
    },
    /// It is a map, but not one for these settings.
    #[error(
        "the map {}: {misfit}. It is left as it is; set that back, name another file, or begin an empty map with --fresh",
        path.display()
    )]
    Misfit {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        misfit: Misfit,
    },
}

/// What of the settings does not fit a saved map.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Misfit {
    /// Cells of another size.
    #[error("its cells have {saved} m a side, and mapper.resolution asks for {wanted}")]
    Resolution {
        /// Of the map (m).
        saved: f64,
        /// Of the settings (m).
        wanted: f64,
    },
    /// Another grid.
    #[error("it is of mapper.mapper = {saved:?}, and the settings ask for {wanted:?}")]
    Mapper {
        /// Of the map.
        saved: String,
        /// Of the settings.
        wanted: String,
    },
    /// Cells with more or fewer ranges of view angles.
    #[error("it was made with mapper.visagge.two_ranges = {saved}, and the settings ask for {wanted}")]
    TwoRanges {
        /// Of the map.
        saved: bool,
        /// Of the settings.
        wanted: bool,
    },
}

/// Whether maps of this kind can be saved: those of the grids for comparison are not.
pub fn is_kept(kind: MapperKind) -> bool {
    matches!(kind, MapperKind::Visagge | MapperKind::Paper)
}

impl SavedMap {
    /// A grid with what else is kept.
    pub fn new(grid: SavedGrid, scans: u64) -> Self {
        Self { program: concat!("visagged ", env!("CARGO_PKG_VERSION")).into(), scans, grid }
    }

    /// Whether a mapper with these settings can go on in it.
    ///
    /// # Errors
    /// Says what does not fit.
    pub fn fits(&self, settings: &MapperSettings) -> Result<(), Misfit> {
        let name = |kind: MapperKind| format!("{kind:?}").to_lowercase();
        let kind = if self.grid.as_in_the_paper { MapperKind::Paper } else { MapperKind::Visagge };
        if kind != settings.mapper {
            return Err(Misfit::Mapper { saved: name(kind), wanted: name(settings.mapper) });
        }
        if self.grid.resolution != settings.resolution {
            return Err(Misfit::Resolution { saved: self.grid.resolution, wanted: settings.resolution });
        }
        let wanted = settings.visagge.two_ranges && kind == MapperKind::Visagge;
        if self.grid.two_ranges != wanted {
            return Err(Misfit::TwoRanges { saved: self.grid.two_ranges, wanted });
        }
        Ok(())
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// Where memory ends.
    pub fn encode(&self) -> io::Result<Vec<u8>> {
        let content = postcard::to_stdvec(self).map_err(io::Error::other)?;
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend(zstd::bulk::compress(&content, LEVEL)?);
        let sum = checksum(&bytes);
        bytes[HEADER - 4..HEADER].copy_from_slice(&sum.to_le_bytes());
        Ok(bytes)
    }

    /// Reads a file's bytes.
    ///
    /// # Errors
    /// Whatever the bytes are, it says why they are no map.
    pub fn decode(bytes: &[u8]) -> Result<Self, Damage> {
        if !bytes.starts_with(&MAGIC[..MAGIC.len().min(bytes.len())]) {
            return Err(Damage::Foreign);
        }
        let Some((header, frame)) = bytes.split_first_chunk::<HEADER>() else {
            return Err(Damage::Short(bytes.len()));
        };
        let word =
            |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let version = word(8);
        if version != VERSION {
            return Err(Damage::Version(version));
        }
        let (want, got) = (word(HEADER - 4), checksum(bytes));
        if want != got {
            return Err(Damage::Checksum { len: bytes.len(), want, got });
        }
        let length = u64::from(word(12)) | u64::from(word(16)) << 32;
        if length > LONGEST {
            return Err(Damage::Content(format!("{length} bytes are more than any map has")));
        }
        let content = zstd::bulk::decompress(frame, length as usize)
            .map_err(|error| Damage::Content(error.to_string()))?;
        let (map, rest) = postcard::take_from_bytes::<Self>(&content)
            .map_err(|error| Damage::Content(error.to_string()))?;
        if !rest.is_empty() {
            return Err(Damage::Content(format!("{} bytes are left over", rest.len())));
        }
        map.grid.check()?;
        Ok(map)
    }
}

/// Of all bytes but its own.
fn checksum(bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..HEADER - 4]);
    hasher.update(&bytes[HEADER..]);
    hasher.finalize()
}

/// A map that was read.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The map.
    pub map: SavedMap,
    /// The file's bytes.
    pub bytes: Vec<u8>,
}

/// A file that holds a map from run to run.
#[derive(Clone, Debug)]
pub struct MapFile {
    path: PathBuf,
    /// Something is there that a fresh start has not read; it is moved away before it would be overwritten.
    moves_former: bool,
}

impl MapFile {
    /// Looks whether the map can be saved there, and reads it where there is one and `fresh` is not wanted.
    ///
    /// # Errors
    /// Where the map is not for these settings, or is none; where the folder is not to be written to.
    pub fn open(
        path: &Path,
        fresh: bool,
        settings: &MapperSettings,
    ) -> Result<(Self, Option<Loaded>), LoadError> {
        let io = |error| LoadError::Io { path: path.to_owned(), error };
        // So that a long run does not find out at its end.
        aside(path).map_err(io)?;
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok((Self { path: path.to_owned(), moves_former: false }, None));
            }
            Err(error) => return Err(io(error)),
        };
        if fresh {
            return Ok((Self { path: path.to_owned(), moves_former: true }, None));
        }
        let map = SavedMap::decode(&bytes)
            .map_err(|damage| LoadError::Damaged { path: path.to_owned(), damage })?;
        map.fits(settings).map_err(|misfit| LoadError::Misfit { path: path.to_owned(), misfit })?;
        Ok((Self { path: path.to_owned(), moves_former: false }, Some(Loaded { map, bytes })))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Puts this map in the place of the one before. What a fresh start found there becomes `NAME.former`.
    ///
    /// # Errors
    /// What the system says; the file is then the one before.
    pub fn save(&mut self, map: &SavedMap) -> io::Result<()> {
        let bytes = map.encode()?;
        let mut file = aside(&self.path)?;
        file.write_all(&bytes)?;
        file.as_file().sync_all()?;
        if self.moves_former {
            let mut former = self.path.clone().into_os_string();
            former.push(".");
            former.push(FORMER);
            std::fs::rename(&self.path, former)?;
            self.moves_former = false;
        }
        file.persist(&self.path)?;
        File::open(folder(&self.path))?.sync_all()
    }
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A new file beside this one, which is removed unless it is renamed.
fn aside(path: &Path) -> io::Result<tempfile::NamedTempFile> {
    use std::os::unix::fs::PermissionsExt;
    // As any other new file: the umask takes away what it takes away.
    let readable = std::fs::Permissions::from_mode(0o666);
    tempfile::Builder::new()
        .prefix(".visagged-")
        .suffix(".part")
        .permissions(readable)
        .tempfile_in(folder(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::saved::{SavedCell, SavedSector, SavedTile};
    use proptest::prelude::*;

    fn map() -> SavedMap {
        let visible = SavedSector { range: [100, 20], ends: [1024, 1152], way: 1.5 };
        let cell = |column: u8| SavedCell {
            place: [column, 5],
            occupancy: 7,
            passes: 1,
            glints: 2,
            hits: 300,
            was_crossed: true,
            was_passed: true,
            was_driven: true,
            brightness: -300,
            hit_scan: 70_000,
            visible,
            visible_too: Some(visible),
            missed_width: 900,
            missed_since: [400, 800],
            centroid: [0.25, 0.75],
            hit_time: [0.5, 100.0],
        };
        let tile = |x: i32, cells| SavedTile {
            place: [x, -4],
            free: vec![u64::MAX << 7; 64],
            driven: vec![3; 64],
            cells,
        };
        SavedMap::new(
            SavedGrid {
                resolution: 0.05,
                as_in_the_paper: false,
                two_ranges: true,
                scan: 70_001,
                way: 250.0,
                elapsed_ns: 1_750_000_000_000,
                middle: Some([1.0, -2.0]),
                tiles: vec![tile(-3, None), tile(9, Some((0..64).map(cell).collect()))],
            },
            69_000,
        )
    }

    #[test]
    fn what_is_saved_is_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.map");
        let settings = MapperSettings::default();
        let (mut file, none) = MapFile::open(&path, false, &settings).unwrap();
        assert!(none.is_none() && !path.exists(), "to look makes nothing");
        file.save(&map()).unwrap();
        let (_, loaded) = MapFile::open(&path, false, &settings).unwrap();
        assert_eq!(loaded.unwrap().map, map());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left");
    }

    #[test]
    fn a_fresh_start_keeps_what_was_there_under_another_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.map");
        std::fs::write(&path, "precious").unwrap();
        let (mut file, none) = MapFile::open(&path, true, &MapperSettings::default()).unwrap();
        assert!(none.is_none());
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
        file.save(&map()).unwrap();
        file.save(&map()).unwrap();
        assert_eq!(std::fs::read(folder.path().join("a.map.former")).unwrap(), b"precious");
        assert!(SavedMap::decode(&std::fs::read(&path).unwrap()).is_ok());
    }

    #[test]
    fn settings_that_do_not_fit_are_named_and_nothing_is_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.map");
        let bytes = map().encode().unwrap();
        std::fs::write(&path, &bytes).unwrap();
        let coarse = MapperSettings { resolution: 0.1, ..MapperSettings::default() };
        let other = MapperSettings { mapper: MapperKind::Paper, ..MapperSettings::default() };
        let mut single = MapperSettings::default();
        single.visagge.two_ranges = false;
        for (settings, words) in [
            (coarse, "0.05 m a side, and mapper.resolution asks for 0.1"),
            (other, "mapper.mapper = \"visagge\", and the settings ask for \"paper\""),
            (single, "two_ranges = true"),
        ] {
            let error = MapFile::open(&path, false, &settings).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("a.map") && error.contains("--fresh"), "{error}");
        }
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn each_kind_of_damage_is_told() {
        let bytes = map().encode().unwrap();
        let with = |at: usize, byte: u8| {
            let mut damaged = bytes.clone();
            damaged[at] ^= byte;
            SavedMap::decode(&damaged).unwrap_err().to_string()
        };
        assert!(with(3, 1).contains("no map that visagged saved"));
        assert!(with(8, 1).contains("saved in format 7"));
        assert!(with(HEADER + 9, 4).contains("damaged or cut short"));
        assert!(SavedMap::decode(&bytes[..17]).unwrap_err().to_string().contains("17 bytes"));
        assert!(SavedMap::decode(&bytes[..bytes.len() - 1]).unwrap_err().to_string().contains("cut short"));
        assert!(matches!(SavedMap::decode(b"P5 640 480"), Err(Damage::Foreign)));
        let mut twice = map();
        twice.grid.tiles.push(twice.grid.tiles[0].clone());
        assert!(matches!(SavedMap::decode(&twice.encode().unwrap()), Err(Damage::Grid(_))));
    }

    #[test]
    fn a_folder_that_is_not_there_is_found_out_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none/a.map");
        let error = MapFile::open(&path, false, &MapperSettings::default()).unwrap_err().to_string();
        assert!(error.contains("none/a.map"), "{error}");
    }

    /// A frame and header around any content, with the right sum.
    fn sealed(content: &[u8], length: u64) -> Vec<u8> {
        let mut bytes = [&MAGIC[..], &VERSION.to_le_bytes(), &length.to_le_bytes(), &[0; 4]].concat();
        bytes.extend(zstd::bulk::compress(content, LEVEL).unwrap());
        let sum = checksum(&bytes);
        bytes[HEADER - 4..HEADER].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    proptest! {
        #[test]
        fn no_bytes_are_taken_for_a_map(bytes in proptest::collection::vec(any::<u8>(), 0..400), as_ours: bool) {
            let bytes = if as_ours { [&MAGIC[..], &VERSION.to_le_bytes(), &bytes].concat() } else { bytes };
            prop_assert!(SavedMap::decode(&bytes).is_err());
        }

        #[test]
        fn whatever_changes_is_noticed(at: prop::sample::Index, change in 1u8.., cut: prop::sample::Index) {
            let mut bytes = map().encode().unwrap();
            prop_assert!(SavedMap::decode(&bytes[..cut.index(bytes.len())]).is_err());
            let at = at.index(bytes.len());
            bytes[at] ^= change;
            prop_assert!(SavedMap::decode(&bytes).is_err());
        }

        /// With a right sum around them: whoever computes it may have written anything.
        #[test]
        fn sealed_nonsense_does_no_harm(at: prop::sample::Index, change in 1u8.., junk in proptest::collection::vec(any::<u8>(), 0..200), length: u64) {
            let mut content = postcard::to_stdvec(&map()).unwrap();
            let at = at.index(content.len());
            content[at] ^= change;
            let _ = SavedMap::decode(&sealed(&content, content.len() as u64));
            let _ = SavedMap::decode(&sealed(&junk, junk.len() as u64));
            prop_assert!(SavedMap::decode(&sealed(&junk, length | 1 << 40)).is_err());
        }
    }
}
