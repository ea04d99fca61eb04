//! How a file is broken: bytes, numbers, lines, the tree of a JSON text, the records of a flight log.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::Record;
use serde_json::Value;

use fastrand::Rng;

/// A broken file is no longer than this [bytes].
const MOST_BYTES: usize = 1 << 21;
/// As often a piece is repeated at the most.
const REPEATS: u64 = 3000;

/// Numbers at which readers go wrong.
const NUMBERS: &str = "0 -0.0 -1 1 0.001 2147483648 -9223372036854775808 9223372036854775807 \
    18446744073709551615 18446744073709551616 4503599627370497.5 1e18 1e19 1e30 -1e30 1e308 5e-324 1e-30 \
    nan inf -inf 1e999 0x7f 1_000";

/// Pieces that mean something in one of the formats, or to a terminal, or nothing at all.
const PIECES: &[u8] = b"[ ] { } \" ' \"\"\" = . , : # \n \r\n \r \0 \x1b[2J \xff\xfe \xef\xbb\xbf null true [[ \
    {\"a\": 1e308 \x89MCAP0\r\n \x28\xb5\x2f\xfd \xff\xff\xff\xff\xff\xff\xff\xff \xe2\x80\xae\xf0\x9f\x98\x80";

/// A length or count that no file has.
fn length(dice: &mut Rng) -> u64 {
    let bits = choice(dice, &[0, 1, 7, 16, 28, 31, 32, 40, 63, 64]);
    u64::MAX.checked_shr(64 - bits).unwrap_or(0)
}

fn any_number(dice: &mut Rng) -> &'static str {
    choice(dice, &NUMBERS.split(' ').collect::<Vec<_>>())
}

fn any_piece(dice: &mut Rng) -> &'static [u8] {
    let pieces = PIECES.split(|byte| *byte == b' ');
    choice(dice, &pieces.collect::<Vec<_>>())
}

/// A place in a file, its end among them.
fn place(dice: &mut Rng, bytes: &[u8]) -> usize {
    dice.u64(..bytes.len() as u64 + 1) as usize
}

/// A piece of a file: most are short.
fn piece(dice: &mut Rng, bytes: &[u8]) -> (usize, usize) {
    let from = place(dice, bytes);
    let most = [4, 64, 1024, u64::MAX][dice.u64(..4) as usize].min((bytes.len() - from) as u64 + 1);
    (from, from + dice.u64(..most) as usize)
}

fn choice<T: Copy>(dice: &mut Rng, of: &[T]) -> T {
    of[dice.u64(..of.len() as u64) as usize]
}

/// Some changes of bytes; `others` are files of the same kind.
pub fn bytes(dice: &mut Rng, file: &[u8], others: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for _ in 0..choice(dice, &[1, 1, 2, 6]) {
        change(dice, &mut bytes, others);
        bytes.truncate(MOST_BYTES);
    }
    bytes
}

fn change(dice: &mut Rng, bytes: &mut Vec<u8>, others: &[Vec<u8>]) {
    let (from, to) = piece(dice, bytes);
    match dice.u64(..10) {
        0 if from < bytes.len() => bytes[from] ^= 1 << dice.u64(..8),
        1 => drop(bytes.drain(from..to)),
        2 => bytes.truncate(from),
        3 => {
            // Copied or moved to another place.
            let taken = bytes[from..to].to_vec();
            if dice.u64(..2) == 0 {
                bytes.drain(from..to);
            }
            let at = place(dice, bytes);
            insert(bytes, at, &taken);
        }
        4 => {
            let other = &others[dice.u64(..others.len() as u64) as usize];
            let (begin, end) = piece(dice, other);
            bytes.splice(from..to, other[begin..end].iter().copied());
        }
        5 => {
            let width = choice(dice, &[4, 8]);
            overwrite(bytes, from, &length(dice).to_le_bytes()[..width]);
        }
        6 => overwrite(bytes, from, any_piece(dice)),
        7 => {
            let (known, many) = (any_piece(dice), dice.u64(..REPEATS) as usize);
            let again = choice(dice, &[known, &bytes[from..to]]).to_vec();
            let times = choice(dice, &[1, many]);
            let times = times.min(MOST_BYTES / again.len().max(1));
            insert(bytes, from, &again.repeat(times));
        }
        8 => number(dice, bytes),
        _ => line(dice, bytes),
    }
}

fn insert(bytes: &mut Vec<u8>, at: usize, more: &[u8]) {
    bytes.splice(at..at, more.iter().copied());
}

fn overwrite(bytes: &mut [u8], at: usize, with: &[u8]) {
    for (byte, with) in bytes[at..].iter_mut().zip(with) {
        *byte = *with;
    }
}

fn number(dice: &mut Rng, bytes: &mut Vec<u8>) {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || b".+-eE".contains(byte);
    let start = place(dice, bytes);
    let Some(at) = bytes[start..].iter().position(u8::is_ascii_digit) else {
        return;
    };
    let digits = &bytes[start + at..];
    let length = digits.iter().take_while(|byte| is_digit(byte)).count();
    let from = start + at;
    let other = match dice.u64(..8) {
        0 => "9".repeat(dice.u64(..REPEATS) as usize),
        _ => any_number(dice).to_owned(),
    };
    bytes.splice(from..from + length, other.into_bytes());
}

/// Takes a line away, doubles it, or puts it elsewhere.
fn line(dice: &mut Rng, bytes: &mut Vec<u8>) {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    let mut lines: Vec<Vec<u8>> = lines.map(<[u8]>::to_vec).collect();
    if lines.is_empty() {
        return;
    }
    let taken = lines.remove(dice.u64(..lines.len() as u64) as usize);
    for _ in 0..dice.u64(..3) {
        lines.insert(dice.u64(..lines.len() as u64 + 1) as usize, taken.clone());
    }
    *bytes = lines.concat();
}

pub fn json(dice: &mut Rng, file: &[u8]) -> Option<Vec<u8>> {
    let mut tree: Value = serde_json::from_slice(file).ok()?;
    for _ in 0..=dice.u64(..4) {
        let elsewhere = somewhere(dice, &mut tree.clone()).clone();
        let place = somewhere(dice, &mut tree);
        let value = place.take();
        *place = other_value(dice, value, elsewhere);
    }
    serde_json::to_vec(&tree).ok()
}

fn somewhere<'a>(dice: &mut Rng, tree: &'a mut Value) -> &'a mut Value {
    let inside = match &*tree {
        Value::Array(values) => values.len(),
        Value::Object(keys) => keys.len(),
        _ => 0,
    };
    if inside == 0 || dice.u64(..12) == 0 {
        return tree;
    }
    let at = dice.u64(..inside as u64) as usize;
    let value = match tree {
        Value::Array(values) => values.get_mut(at),
        Value::Object(keys) => keys.values_mut().nth(at),
        _ => None,
    };
    somewhere(dice, value.expect("a place inside"))
}

fn other_value(dice: &mut Rng, value: Value, elsewhere: Value) -> Value {
    match (dice.u64(..6), value) {
        (0, _) => Value::Null,
        (1, _) => elsewhere,
        (2, _) => Value::from("</p><script>".repeat(dice.u64(..REPEATS / 10) as usize)),
        (3, Value::Array(values)) => {
            let values = values
                .iter()
                .cycle()
                .take(REPEATS as usize * values.len().min(1));
            Value::from_iter(values.cloned())
        }
        (4, Value::Object(_)) => Value::from(serde_json::Map::new()),
        (_, Value::Number(_)) => serde_json::from_str(any_number(dice)).unwrap_or(Value::Null),
        (_, value) => value,
    }
}

/// A flight log with changed records, written again with the checksums that they have then.
pub fn log(dice: &mut Rng, file: &[u8]) -> Option<Vec<u8>> {
    let records = mcap::read::ChunkFlattener::new(file).ok()?;
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(Cursor::new(Vec::new())).ok()?;
    // Of many messages a few are to be changed, and at times nearly all.
    let rarely = choice(dice, &[3, 30, 300, 3000]);
    for record in records {
        let mut record = record.ok()?;
        if dice.u64(..rarely) == 0 {
            change_record(dice, &mut record);
        }
        match &record {
            Record::Schema { header, data } => {
                let (name, encoding) = (&header.name, &header.encoding);
                let _ = writer.add_schema_with_id(header.id, name, encoding, data);
            }
            Record::Channel(it) => {
                let (topic, encoding, facts) = (&it.topic, &it.message_encoding, &it.metadata);
                let _ = writer.add_channel_with_id(it.id, it.schema_id, topic, encoding, facts);
            }
            Record::Metadata(metadata) => writer.write_metadata(metadata).ok()?,
            Record::Message { header, data } => {
                // One that is missing, one that is there twice.
                let times = if dice.u64(..rarely) == 0 {
                    dice.u64(..3)
                } else {
                    1
                };
                for _ in 0..times {
                    let _ = writer.write_to_known_channel(header, data);
                }
            }
            _ => {}
        }
    }
    writer.finish().ok()?;
    Some(writer.into_inner().into_inner())
}

fn change_record(dice: &mut Rng, record: &mut Record<'_>) {
    match record {
        Record::Schema { data, .. } => *data = Cow::Owned(bytes_of(dice, data)),
        Record::Channel(channel) => words(dice, &mut channel.metadata),
        Record::Metadata(facts) => words(dice, &mut facts.metadata),
        Record::Message { header, .. } if dice.u64(..8) == 0 => header.log_time = length(dice),
        Record::Message { data, .. } => *data = Cow::Owned(bytes_of(dice, data)),
        _ => {}
    }
}

fn bytes_of(dice: &mut Rng, data: &[u8]) -> Vec<u8> {
    bytes(dice, data, &[data.to_vec()])
}

fn words(dice: &mut Rng, facts: &mut BTreeMap<String, String>) {
    let at = dice.u64(..facts.len().max(1) as u64) as usize;
    if let Some(word) = facts.values_mut().nth(at) {
        *word = String::from_utf8_lossy(&bytes_of(dice, word.as_bytes())).into_owned();
    }
}
