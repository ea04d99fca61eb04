//! What was injected into the flight of a log: read before the log is, in which it stands wherever there was news.

use crate::facts::INJECTED;
use errors::{Failure, InFile as _, open_file};
use mcap::records::{Record, op};
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::path::Path;

/// What stands before an MCAP's first record [bytes].
const MAGIC: u64 = 8;
/// A record of faults is no longer [bytes].
const LONGEST: u64 = 1 << 20;

/// The faults that were injected into the flight of a log, in order, in the words that plan the same. What of them is
/// damaged or missing is left out here: the log's reader says so.
pub fn injected(log: &Path) -> Result<Vec<String>, Failure> {
    let mut faults = Vec::new();
    for part in 0.. {
        let path = match part {
            0 => log.to_owned(),
            part => log.with_file_name(crate::file_name(part)),
        };
        if part > 0 && !(log.ends_with(crate::FILE) && path.exists()) {
            break;
        }
        let mut file = open_file(&path).in_file("read the flight log", &path)?;
        // The last record has all of them. A file that was begun shortly before its recorder was killed has none.
        let in_this = in_file(&mut file).in_file("read the flight log", &path)?;
        faults = if in_this.is_empty() { faults } else { in_this };
    }
    Ok(faults)
}

fn in_file(file: &mut File) -> io::Result<Vec<String>> {
    let length = file.seek(SeekFrom::End(0))?;
    let (mut place, mut faults) = (MAGIC, Vec::new());
    let mut head = [0; 9];
    while place + head.len() as u64 <= length {
        file.seek(SeekFrom::Start(place))?;
        file.read_exact(&mut head)?;
        let [opcode, size @ ..] = head;
        let size = u64::from_le_bytes(size);
        let begin = place + head.len() as u64;
        let Some(end) = begin.checked_add(size).filter(|end| *end <= length) else {
            break;
        };
        place = end;
        if opcode != op::METADATA || size > LONGEST {
            continue;
        }
        let mut bytes = vec![0; usize::try_from(size).unwrap_or_default()];
        file.read_exact(&mut bytes)?;
        if let Ok(Record::Metadata(metadata)) = mcap::parse_record(opcode, &bytes)
            && metadata.name == INJECTED
        {
            let mut numbered: Vec<(u64, String)> = metadata
                .metadata
                .into_iter()
                .filter_map(|(n, fault)| Some((n.parse().ok()?, fault)))
                .collect();
            numbered.sort_unstable();
            faults = numbered.into_iter().map(|(_, fault)| fault).collect();
        }
    }
    Ok(faults)
}
