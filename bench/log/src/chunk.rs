//! A chunk of the log as it is read: decompressed at once, and checked before its first record is.

use mcap::McapError;
use mcap::records::{Record, op};
use zstd::bulk::Decompressor;

/// A record longer than this, or a chunk, is no log's [bytes].
pub(crate) const RECORD_LIMIT: usize = 1 << 27;

/// Length of what stands before a record: what it is, and how long [bytes].
const RECORD_HEADER: usize = 1 + 8;

pub(crate) struct Chunk {
    decompressor: Decompressor<'static>,
    records: Vec<u8>,
    /// How far these have been read [bytes].
    read: usize,
}

impl Chunk {
    pub fn new() -> std::io::Result<Self> {
        Ok(Self {
            decompressor: Decompressor::new()?,
            records: Vec::new(),
            read: 0,
        })
    }

    /// Takes the next chunk's record in the place of this one.
    pub fn open(&mut self, record: &[u8]) -> Result<(), McapError> {
        let Record::Chunk { header, data } = mcap::parse_record(op::CHUNK, record)? else {
            return Err(McapError::UnexpectedEoc);
        };
        let length = header.uncompressed_size;
        if length > RECORD_LIMIT as u64 {
            return Err(McapError::ChunkTooLarge(length));
        }
        let length = length as usize;
        self.records.clear();
        self.read = 0;
        match header.compression.as_str() {
            "" => self.records.extend_from_slice(&data),
            "zstd" => {
                self.records.reserve_exact(length);
                let failed = |e: std::io::Error| McapError::DecompressionError(e.to_string());
                let decompressor = &mut self.decompressor;
                let decompressed = decompressor.decompress_to_buffer(&data, &mut self.records);
                decompressed.map_err(failed)?;
            }
            _ => return Err(McapError::UnsupportedCompression(header.compression)),
        }
        let (saved, calculated) = (header.uncompressed_crc, crc32fast::hash(&self.records));
        let is_whole = self.records.len() == length;
        if is_whole && (saved == 0 || saved == calculated) {
            return Ok(());
        }
        self.records.clear();
        Err(match is_whole {
            true => McapError::BadChunkCrc { saved, calculated },
            false => McapError::UnexpectedEoc,
        })
    }

    /// The next record: what it is, and its bytes; none at the chunk's end.
    pub fn next(&mut self) -> Option<Result<(u8, &[u8]), McapError>> {
        let rest = &self.records[self.read..];
        if rest.is_empty() {
            return None;
        }
        let record =
            rest.split_first_chunk::<RECORD_HEADER>()
                .and_then(|(&[opcode, length @ ..], rest)| {
                    let length = usize::try_from(u64::from_le_bytes(length)).ok()?;
                    Some((opcode, rest.get(..length)?))
                });
        self.read = record.map_or(self.records.len(), |(_, data)| {
            self.read + RECORD_HEADER + data.len()
        });
        Some(record.ok_or(McapError::UnexpectedEoc))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chunk's record: of how many bytes it says that it consists, their checksum, and how they are compressed.
    fn chunk(length: u64, crc: u32, compression: &str, data: &[u8]) -> Vec<u8> {
        let mut record = vec![0; 16];
        record.extend(length.to_le_bytes());
        record.extend(crc.to_le_bytes());
        record.extend((compression.len() as u32).to_le_bytes());
        record.extend(compression.as_bytes());
        record.extend((data.len() as u64).to_le_bytes());
        record.extend(data);
        record
    }

    #[test]
    fn records_of_a_chunk_are_read_only_where_all_of_it_is_right() {
        let record = [&[op::MESSAGE][..], &3_u64.to_le_bytes(), b"one"].concat();
        let records = record.repeat(2);
        let (crc, length) = (crc32fast::hash(&records), records.len() as u64);
        let zstd = zstd::bulk::compress(&records, 1).unwrap();
        let mut reader = Chunk::new().unwrap();
        for (length, crc, compression, data, expected) in [
            (length, crc, "zstd", &zstd[..], ""),
            (length, 0, "", &records, ""),
            (length, crc ^ 1, "zstd", &zstd, "Chunk CRC failed"),
            (length, crc, "zstd", &zstd[..9], "during decompression"),
            (length - 1, crc, "zstd", &zstd, "in the middle of a record"),
            (u64::MAX, crc, "zstd", &zstd, "length exceeds limit"),
            (length, crc, "lz5", &zstd, "Unsupported compression"),
        ] {
            let opened = reader.open(&chunk(length, crc, compression, data));
            let said = opened.map_or_else(|e| e.to_string(), |()| String::new());
            let (is_said, reads) = (said.contains(expected), said.is_empty());
            assert!(is_said && reads == expected.is_empty(), "{said}");
            let read = std::iter::from_fn(|| Some(reader.next()?.unwrap().1.to_vec()));
            assert!(read.eq(vec![b"one"; 2 * usize::from(reads)]), "{said}");
        }
        reader
            .open(&chunk(length - 1, 0, "", &records[1..]))
            .unwrap();
        let cut = reader.next().map(|record| record.map(drop));
        assert!(matches!(cut, Some(Err(McapError::UnexpectedEoc))));
    }
}
