//! How a file is broken: bytes, numbers, lines, the tree of a JSON text, the records of a flight log.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, Metadata, Record};
use serde_json::Value;

use crate::recorded::Dice;

/// A broken file is no longer than this [bytes].
const MOST_BYTES: usize = 1 << 21;
/// As often a piece is repeated at the most.
const REPEATS: u64 = 3000;

/// Numbers at which readers go wrong.
const NUMBERS: [&str; 24] = [
    "0",
    "-0.0",
    "-1",
    "1",
    "0.001",
    "2147483648",
    "-9223372036854775808",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "4503599627370497.5",
    "1e18",
    "1e19",
    "1e30",
    "-1e30",
    "1e308",
    "5e-324",
    "1e-30",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "0x7f",
    "1_000",
];

/// Pieces that mean something in one of the formats, or to a terminal, or to nobody.
const PIECES: [&[u8]; 28] = [
    b"[",
    b"]",
    b"{",
    b"}",
    b"\"",
    b"'",
    b"\"\"\"",
    b"=",
    b".",
    b",",
    b":",
    b"#",
    b"\n",
    b"\r\n",
    b"\r",
    b"\0",
    b"\x1b[2J",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    "\u{202e}\u{1f600}".as_bytes(),
    b"null",
    b"true",
    b"[[",
    b"{\"a\":",
    b"\x89MCAP0\r\n",
    b"\x28\xb5\x2f\xfd",
    b"\xff\xff\xff\xff\xff\xff\xff\xff",
    b"1e308",
];

/// Lengths and counts that no file has.
const LENGTHS: [u64; 10] = [
    0,
    1,
    0x7f,
    0xffff,
    0x1000_0000,
    0x7fff_ffff,
    0xffff_ffff,
    1 << 40,
    i64::MAX.cast_unsigned(),
    u64::MAX,
];

/// A place in a file, its end among them.
fn place(dice: &mut Dice, bytes: &[u8]) -> usize {
    dice.roll(bytes.len() as u64 + 1) as usize
}

/// A piece of a file: most are short.
fn piece(dice: &mut Dice, bytes: &[u8]) -> (usize, usize) {
    let from = place(dice, bytes);
    let most = [4, 64, 1024, u64::MAX][dice.roll(4) as usize].min((bytes.len() - from) as u64 + 1);
    (from, from + dice.roll(most) as usize)
}

fn choice<T: Copy>(dice: &mut Dice, of: &[T]) -> T {
    of[dice.roll(of.len() as u64) as usize]
}

/// Some changes of bytes; `others` are files of the same kind.
pub fn bytes(dice: &mut Dice, file: &[u8], others: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for _ in 0..choice(dice, &[1, 1, 2, 6]) {
        change(dice, &mut bytes, others);
        bytes.truncate(MOST_BYTES);
    }
    bytes
}

fn change(dice: &mut Dice, bytes: &mut Vec<u8>, others: &[Vec<u8>]) {
    let (from, to) = piece(dice, bytes);
    match dice.roll(14) {
        0 if from < bytes.len() => bytes[from] ^= 1 << dice.roll(8),
        1 if from < bytes.len() => {
            bytes[from] = choice(dice, &[0, 1, 0x7f, 0x80, 0xff, b'-', b'9', b'"', b'['])
        }
        2 => drop(bytes.drain(from..to)),
        3 => bytes.truncate(from),
        4 => {
            let (again, at) = (bytes[from..to].to_vec(), place(dice, bytes));
            insert(bytes, at, &again);
        }
        5 => {
            let taken: Vec<u8> = bytes.drain(from..to).collect();
            let at = place(dice, bytes);
            insert(bytes, at, &taken);
        }
        6 => {
            let other = &others[dice.roll(others.len() as u64) as usize];
            let (begin, end) = piece(dice, other);
            bytes.splice(from..to, other[begin..end].iter().copied());
        }
        7 => insert(bytes, from, choice(dice, &PIECES)),
        8 => overwrite(bytes, from, &choice(dice, &LENGTHS).to_le_bytes()),
        9 => overwrite(bytes, from, &(choice(dice, &LENGTHS) as u32).to_le_bytes()),
        10 => {
            let times = dice.roll(REPEATS) as usize;
            let again = if dice.roll(2) == 0 {
                choice(dice, &PIECES).to_vec()
            } else {
                bytes[from..to].to_vec()
            };
            let times = times.min(MOST_BYTES / again.len().max(1));
            insert(bytes, from, &again.repeat(times));
        }
        11 | 12 => number(dice, bytes),
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

/// Writes another number where one is, or many digits.
fn number(dice: &mut Dice, bytes: &mut Vec<u8>) {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || b".+-eE".contains(byte);
    let start = place(dice, bytes);
    let Some(from) = bytes[start..]
        .iter()
        .position(u8::is_ascii_digit)
        .map(|at| start + at)
    else {
        return;
    };
    let length = bytes[from..]
        .iter()
        .take_while(|byte| is_digit(byte))
        .count();
    let other = match dice.roll(8) {
        0 => "9".repeat(dice.roll(REPEATS) as usize),
        _ => choice(dice, &NUMBERS).to_owned(),
    };
    bytes.splice(from..from + length, other.into_bytes());
}

/// Takes a line away, doubles it, or puts it elsewhere.
fn line(dice: &mut Dice, bytes: &mut Vec<u8>) {
    let mut lines: Vec<Vec<u8>> = bytes
        .split_inclusive(|byte| *byte == b'\n')
        .map(<[u8]>::to_vec)
        .collect();
    if lines.is_empty() {
        return;
    }
    let taken = lines.remove(dice.roll(lines.len() as u64) as usize);
    for _ in 0..dice.roll(3) {
        lines.insert(dice.roll(lines.len() as u64 + 1) as usize, taken.clone());
    }
    *bytes = lines.concat();
}

/// A JSON text with other values in some places.
pub fn json(dice: &mut Dice, file: &[u8]) -> Option<Vec<u8>> {
    let mut tree: Value = serde_json::from_slice(file).ok()?;
    for _ in 0..=dice.roll(4) {
        let elsewhere = somewhere(dice, &mut tree.clone()).clone();
        let place = somewhere(dice, &mut tree);
        let value = place.take();
        *place = other_value(dice, value, elsewhere);
    }
    serde_json::to_vec(&tree).ok()
}

/// A place in a tree; most are leaves.
fn somewhere<'a>(dice: &mut Dice, tree: &'a mut Value) -> &'a mut Value {
    let inside = match tree {
        Value::Array(values) => values.len() as u64,
        Value::Object(keys) => keys.len() as u64,
        _ => 0,
    };
    if inside == 0 || dice.roll(12) == 0 {
        return tree;
    }
    let at = dice.roll(inside) as usize;
    match tree {
        Value::Array(values) => somewhere(dice, &mut values[at]),
        Value::Object(keys) => match keys.values_mut().nth(at) {
            Some(value) => somewhere(dice, value),
            None => unreachable!("{at} of {inside} keys"),
        },
        leaf => leaf,
    }
}

fn other_value(dice: &mut Dice, value: Value, elsewhere: Value) -> Value {
    let whole = |number: u64| Value::from(number);
    match (dice.roll(10), value) {
        (0, _) => Value::Null,
        (1, _) => elsewhere,
        (2, _) => Value::from("</p><script>".repeat(dice.roll(REPEATS / 10) as usize)),
        (3, _) => whole(choice(dice, &LENGTHS)),
        (4, Value::Array(values)) => {
            let times = 1 + dice.roll(REPEATS) as usize / values.len().max(1);
            Value::Array(
                values
                    .iter()
                    .cloned()
                    .cycle()
                    .take(values.len() * times)
                    .collect(),
            )
        }
        (5, Value::Array(mut values)) => {
            values.truncate(dice.roll(values.len() as u64 + 1) as usize);
            Value::Array(values)
        }
        (6, Value::Object(mut keys)) => {
            let gone = keys
                .keys()
                .nth(dice.roll(keys.len() as u64 + 1) as usize)
                .cloned();
            gone.map(|key| keys.remove(&key));
            Value::Object(keys)
        }
        (_, Value::Number(number)) if number.is_u64() && dice.roll(2) == 0 => {
            whole(choice(dice, &LENGTHS))
        }
        (_, Value::Number(_)) => {
            serde_json::from_str(choice(dice, &NUMBERS)).unwrap_or(Value::Null)
        }
        (_, Value::Bool(it)) => Value::Bool(!it),
        (_, value) => value,
    }
}

/// A flight log with changed records, written again with the checksums that they have then.
pub fn log(dice: &mut Dice, file: &[u8]) -> Option<Vec<u8>> {
    let records = mcap::read::ChunkFlattener::new(file).ok()?;
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(Cursor::new(Vec::new())).ok()?;
    // Of many messages a few are to be changed, and at times nearly all.
    let rarely = choice(dice, &[3, 30, 300, 3000]);
    for record in records {
        let times = if dice.roll(rarely) == 0 {
            dice.roll(3)
        } else {
            1
        };
        let changed = dice.roll(rarely) == 0;
        for _ in 0..times {
            match record.as_ref().ok()? {
                Record::Schema { header, data } => {
                    let data = if changed {
                        bytes_of(dice, data)
                    } else {
                        data.to_vec()
                    };
                    let _ =
                        writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data);
                }
                Record::Channel(channel) => {
                    let metadata = if changed {
                        words(dice, &channel.metadata)
                    } else {
                        channel.metadata.clone()
                    };
                    let (id, schema) = (channel.id, channel.schema_id);
                    let _ = writer.add_channel_with_id(
                        id,
                        schema,
                        &channel.topic,
                        &channel.message_encoding,
                        &metadata,
                    );
                }
                Record::Metadata(Metadata { name, metadata }) => {
                    let metadata = if changed {
                        words(dice, metadata)
                    } else {
                        metadata.clone()
                    };
                    writer
                        .write_metadata(&Metadata {
                            name: name.clone(),
                            metadata,
                        })
                        .ok()?;
                }
                Record::Message { header, data } => {
                    let mut header: MessageHeader = *header;
                    let mut data: Cow<'_, [u8]> = Cow::Borrowed(data);
                    if changed {
                        match dice.roll(8) {
                            0 => header.channel_id = dice.roll(16) as u16,
                            1 => header.log_time = choice(dice, &LENGTHS),
                            _ => data = Cow::Owned(message(dice, &data)),
                        }
                    }
                    let _ = writer.write_to_known_channel(&header, &data);
                }
                _ => {}
            }
        }
    }
    writer.finish().ok()?;
    Some(writer.into_inner().into_inner())
}

/// A message with other words: numbers of eight bytes, which layouts have nothing but, stand behind tags.
fn message(dice: &mut Dice, data: &[u8]) -> Vec<u8> {
    let mut data = data.to_vec();
    for _ in 0..=dice.roll(3) {
        let at = place(dice, &data);
        match dice.roll(4) {
            0 => overwrite(&mut data, at, &choice(dice, &LENGTHS).to_le_bytes()),
            1 => overwrite(
                &mut data,
                at,
                &choice(dice, &[f64::NAN, 1e300, -0.0, f64::MAX]).to_le_bytes(),
            ),
            2 => return bytes_of(dice, &data),
            _ => overwrite(&mut data, at, &[1 << dice.roll(8)]),
        }
    }
    data
}

fn bytes_of(dice: &mut Dice, data: &[u8]) -> Vec<u8> {
    bytes(dice, data, &[data.to_vec()])
}

/// Facts of a log with another word among them.
fn words(dice: &mut Dice, facts: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let mut facts = facts.clone();
    let Some((name, word)) = facts
        .iter()
        .nth(dice.roll(facts.len().max(1) as u64) as usize)
    else {
        return facts;
    };
    let (name, word) = (name.clone(), word.clone());
    match dice.roll(4) {
        0 => drop(facts.remove(&name)),
        1 => drop(facts.insert(name, choice(dice, &NUMBERS).to_owned())),
        _ => drop(facts.insert(
            name,
            String::from_utf8_lossy(&bytes_of(dice, word.as_bytes())).into_owned(),
        )),
    }
    facts
}
