//! Encodes small Protobuf messages from their field numbers and values.

use prost::encoding::{WireType, double, encode_key, encode_varint};

#[derive(Clone, Copy, Debug)]
pub(crate) enum Value<'a> {
    Number(u64),
    Text(&'a str),
    Message(&'a [u8]),
}

/// A message with these fields, in the order of their numbers.
pub(crate) fn message(fields: &[(u32, Value<'_>)]) -> Vec<u8> {
    let mut out = Vec::new();
    for (number, value) in fields {
        let bytes = match value {
            Value::Number(value) => {
                encode_key(*number, WireType::Varint, &mut out);
                encode_varint(*value, &mut out);
                continue;
            }
            Value::Text(text) => text.as_bytes(),
            Value::Message(bytes) => bytes,
        };
        encode_key(*number, WireType::LengthDelimited, &mut out);
        encode_varint(bytes.len() as u64, &mut out);
        out.extend(bytes);
    }
    out
}

/// A message of `double` fields, numbered from 1; like prost, it leaves zeros out.
pub(crate) fn doubles(values: &[f64]) -> Vec<u8> {
    let mut out = Vec::new();
    for (number, value) in (1..).zip(values).filter(|(_, value)| **value != 0.0) {
        double::encode(number, value, &mut out);
    }
    out
}
