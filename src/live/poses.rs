//! The pose thread: datagrams from the socket, poses to the mapper.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use log::{error, info, warn};

use super::clock;
use super::mapping::ToMapper;
use super::queues::Sender;
use super::shared::{Shared, lock};
use crate::pose_input::{LONGEST_DATAGRAM, PoseReader, PoseSocket};

/// How long a wait for a datagram lasts, and so the end of the run may.
const PATIENCE: Duration = Duration::from_millis(100);

/// Receives poses until told to end.
pub fn run(socket: &PoseSocket, mut reader: PoseReader, mapper: &Sender<ToMapper>, shared: &Arc<Shared>) {
    let mut buffer = [0; LONGEST_DATAGRAM];
    let mut is_first = true;
    while !shared.stop_poses.load(Relaxed) {
        let length = match socket.receive(&mut buffer, PATIENCE) {
            Ok(Some(length)) => length,
            Ok(None) => continue,
            Err(error) => {
                error!("poses cannot be received any more: {error}");
                return;
            }
        };
        match reader.read(&buffer[..length], clock::both()) {
            Ok(pose) => {
                if std::mem::take(&mut is_first) {
                    info!("poses arrive");
                }
                // A refused pose is counted by the queue.
                if mapper.offer(ToMapper::Pose(pose)) {
                    lock(&shared.poses).accepted += 1;
                }
            }
            Err(rejection) => {
                let rejected = reader.rejected().clone();
                if rejected[rejection.name()] == 1 {
                    warn!("a pose was rejected: {}; further ones are only counted", rejection.name());
                }
                lock(&shared.poses).rejected = rejected;
            }
        }
    }
}
