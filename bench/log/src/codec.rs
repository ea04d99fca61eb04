//! Encodes and decodes messages as Protobuf, driven by their layouts.
//!
//! The envelope is field 1. The fields of the content follow from 2 on, in the order of the layout. Integers are
//! `fixed64` and floats are `double`, so every bit is kept. Every field is written, zeros too, so all messages of a
//! type have the same size. The reader insists on exactly that: a message that deviates was not written with this
//! layout.
//!
//! What a law shows in its stage's message is left out: it has a message of its own, with names ([`crate::telemetry`]).

use messages::header::{Header, Message};
use messages::layout::{FNV_OFFSET, Field, Kind, Visit, Visitor, VisitorMut, fnv1a};
use messages::telemetry::Telemetry;
use messages::topic::Topic;

pub const ENVELOPE_NUMBER: u32 = 1;
pub const CONTENT_NUMBER: u32 = 2;

const FIXED64: u32 = 1;
const LENGTH_DELIMITED: u32 = 2;

pub trait Logged: Topic + Visit {}

impl<C: Topic + Visit> Logged for C {}

/// Whether a field is telemetry, which is logged beside the message that it came in.
pub const fn is_telemetry(field: &Field) -> bool {
    matches!(field.kind, Kind::Struct { name, .. } if is_called_telemetry(name))
}

const fn is_called_telemetry(name: &str) -> bool {
    const TELEMETRY: u64 = fnv1a(FNV_OFFSET, Telemetry::STRUCT.as_bytes());
    fnv1a(FNV_OFFSET, name.as_bytes()) == TELEMETRY
}

pub fn encode<C: Logged>(message: &Message<C>, out: &mut Vec<u8>) {
    let begin = out.len();
    out.resize(begin + const { message_length::<C>() }, 0);
    let mut encoder = Encoder {
        out: &mut out[begin..],
        at: 0,
        number: ENVELOPE_NUMBER,
    };
    encoder.nested(&message.envelope);
    encoder.number = CONTENT_NUMBER;
    message.content.visit(&mut encoder);
}

/// Reads a message, without what a law shows in it; `None` where the bytes are not one.
pub fn decode<C: Logged>(bytes: &[u8]) -> Option<Message<C>> {
    let mut message = Message::default();
    decode_into(bytes, &mut message).then_some(message)
}

/// Reads a message into the place of another one, of which the telemetry stays; false where the bytes are not one, and
/// then none stands there.
pub fn decode_into<C: Logged>(bytes: &[u8], message: &mut Message<C>) -> bool {
    // So every field has its place, which the compiler knows.
    if bytes.len() != const { message_length::<C>() } {
        return false;
    }
    let mut decoder = Decoder {
        bytes,
        at: 0,
        number: ENVELOPE_NUMBER,
        whole: true,
    };
    decoder.nested(&mut message.envelope);
    decoder.number = CONTENT_NUMBER;
    message.content.visit_mut(&mut decoder);
    decoder.whole
}

/// The tag of a field that is a word, as one byte or two: of a number below 2048.
const fn word_tag(number: u32) -> ([u8; 2], usize) {
    let tag = number << 3 | FIXED64;
    match tag {
        0..0x80 => ([tag as u8, 0], 1),
        _ => ([tag as u8 | 0x80, (tag >> 7) as u8], 2),
    }
}

/// Writes a field that is a word: a whole number, or the bits of another one.
pub(crate) fn put_word(number: u32, word: u64, out: &mut Vec<u8>) {
    let (tag, length) = word_tag(number);
    out.extend_from_slice(&tag[..length]);
    out.extend_from_slice(&word.to_le_bytes());
}

/// Takes such a field off; `None` where it is not the next one.
pub(crate) fn take_word(number: u32, bytes: &mut &[u8]) -> Option<u64> {
    let (tag, length) = word_tag(number);
    let (word, rest) = bytes.strip_prefix(&tag[..length])?.split_first_chunk()?;
    *bytes = rest;
    Some(u64::from_le_bytes(*word))
}

/// Length of a message as it is logged [bytes].
const fn message_length<C: Logged>() -> usize {
    delimited_length(1, nested_length::<Header>()) + encoded_length(C::FIELDS, CONTENT_NUMBER)
}

const fn nested_length<L: Visit>() -> usize {
    encoded_length(L::FIELDS, ENVELOPE_NUMBER)
}

/// Length of a struct's fields, numbered from `first` on [bytes].
const fn encoded_length(fields: &[Field], first: u32) -> usize {
    let (mut sum, mut i) = (0, 0);
    while i < fields.len() {
        let tag = varint_length(((first as u64) + i as u64) << 3);
        sum += match (fields[i].kind, fields[i].length) {
            _ if is_telemetry(&fields[i]) => 0,
            (Kind::Struct { fields, .. }, length) => {
                let each = delimited_length(tag, encoded_length(fields, ENVELOPE_NUMBER));
                match length {
                    Some(length) => length * each,
                    None => each,
                }
            }
            (Kind::U64 | Kind::F64, None) => tag + size_of::<u64>(),
            (Kind::U64 | Kind::F64, Some(length)) => {
                delimited_length(tag, length * size_of::<u64>())
            }
            // Not shown to a visitor, and in no message.
            (Kind::U8 | Kind::I64, _) => 0,
        };
        i += 1;
    }
    sum
}

const fn delimited_length(tag: usize, length: usize) -> usize {
    tag + varint_length(length as u64) + length
}

const fn varint_length(value: u64) -> usize {
    (u64::BITS - (value | 1).leading_zeros()).div_ceil(7) as usize
}

/// Writes fields. Inlined as a whole: then every tag and every place is a constant.
struct Encoder<'a> {
    out: &'a mut [u8],
    at: usize,
    number: u32,
}

impl Encoder<'_> {
    #[inline(always)]
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.out[self.at] = value as u8 | 0x80;
            self.at += 1;
            value >>= 7;
        }
        self.out[self.at] = value as u8;
        self.at += 1;
    }

    #[inline(always)]
    fn tag(&mut self, wire_type: u32) {
        self.varint(u64::from(self.number << 3 | wire_type));
    }

    #[inline(always)]
    fn nested<L: Visit>(&mut self, value: &L) {
        self.tag(LENGTH_DELIMITED);
        self.varint(const { nested_length::<L>() as u64 });
        let outside = self.number;
        self.number = ENVELOPE_NUMBER;
        value.visit(self);
        self.number = outside;
    }

    #[inline(always)]
    fn words(&mut self, field: &Field, words: impl ExactSizeIterator<Item = u64>) {
        let length = words.len() * size_of::<u64>();
        if field.length.is_some() {
            self.tag(LENGTH_DELIMITED);
            self.varint(length as u64);
        } else {
            self.tag(FIXED64);
        }
        let places = self.out[self.at..][..length].as_chunks_mut().0;
        for (place, word) in places.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        self.at += length;
        self.number += 1;
    }
}

impl Visitor for Encoder<'_> {
    #[inline(always)]
    fn integers(&mut self, field: &'static Field, values: &[u64]) {
        self.words(field, values.iter().copied());
    }

    #[inline(always)]
    fn numbers(&mut self, field: &'static Field, values: &[f64]) {
        self.words(field, values.iter().map(|value| value.to_bits()));
    }

    #[inline(always)]
    fn structs<L: Visit>(&mut self, _: &'static Field, values: &[L]) {
        if const { is_called_telemetry(L::STRUCT) } {
            return;
        }
        for value in values {
            self.nested(value);
        }
        self.number += 1;
    }
}

/// Reads fields from bytes of the right length. Inlined as [`Encoder`] is.
struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
    number: u32,
    whole: bool,
}

impl Decoder<'_> {
    /// Takes a varint, which must be this one and as short as it can be.
    #[inline(always)]
    fn expect(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.whole &= self.bytes[self.at] == value as u8 | 0x80;
            self.at += 1;
            value >>= 7;
        }
        self.whole &= self.bytes[self.at] == value as u8;
        self.at += 1;
    }

    #[inline(always)]
    fn tag(&mut self, wire_type: u32) {
        self.expect(u64::from(self.number << 3 | wire_type));
    }

    #[inline(always)]
    fn nested<L: Visit>(&mut self, value: &mut L) {
        self.tag(LENGTH_DELIMITED);
        self.expect(const { nested_length::<L>() as u64 });
        let outside = self.number;
        self.number = ENVELOPE_NUMBER;
        value.visit_mut(self);
        self.number = outside;
    }

    #[inline(always)]
    fn words(&mut self, field: &Field, count: usize) -> impl Iterator<Item = u64> {
        let length = count * size_of::<u64>();
        if field.length.is_some() {
            self.tag(LENGTH_DELIMITED);
            self.expect(length as u64);
        } else {
            self.tag(FIXED64);
        }
        let words = self.bytes[self.at..][..length].as_chunks().0.iter();
        self.at += length;
        self.number += 1;
        words.map(|word| u64::from_le_bytes(*word))
    }
}

impl VisitorMut for Decoder<'_> {
    #[inline(always)]
    fn integers(&mut self, field: &'static Field, values: &mut [u64]) {
        let words = self.words(field, values.len());
        for (value, word) in values.iter_mut().zip(words) {
            *value = word;
        }
    }

    #[inline(always)]
    fn numbers(&mut self, field: &'static Field, values: &mut [f64]) {
        let words = self.words(field, values.len());
        for (value, word) in values.iter_mut().zip(words) {
            *value = f64::from_bits(word);
        }
    }

    #[inline(always)]
    fn structs<L: Visit>(&mut self, _: &'static Field, values: &mut [L]) {
        if const { is_called_telemetry(L::STRUCT) } {
            return;
        }
        for value in values {
            self.nested(value);
        }
        self.number += 1;
    }
}

#[cfg(test)]
mod tests {
    use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
    use messages::layout::change_words;
    use messages::monitor::Monitor;
    use proptest::prelude::*;

    use super::*;

    pub(crate) fn filled<C: Logged>(seed: u64) -> Message<C> {
        let mut word = seed;
        let mut message = Message::<C>::default();
        let mut next = || {
            word = word
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            word.rotate_right((word >> 59) as u32)
        };
        change_words(&mut message.envelope, |_, _| next());
        change_words(&mut message.content, |_, _| next());
        message
    }

    fn comes_back<C: Logged>(seed: u64) {
        let message = filled::<C>(seed);
        let (mut bytes, mut again) = (Vec::new(), Vec::new());
        encode(&message, &mut bytes);
        let read = decode::<C>(&bytes).unwrap_or_else(|| panic!("{} {seed}", C::NAME));
        encode(&read, &mut again);
        // Bytes, because a random word may be a number that is none, and equals nothing.
        assert_eq!(bytes, again, "{} {seed}", C::NAME);
        assert_eq!(read.envelope, message.envelope);
        assert!(
            decode::<C>(&bytes[..bytes.len() - 1]).is_none(),
            "a byte is missing"
        );
        bytes.push(0);
        assert!(decode::<C>(&bytes).is_none(), "a byte too many");
    }

    proptest! {
        #[test]
        fn every_bit_of_every_message_comes_back(seed in any::<u64>()) {
            comes_back::<State>(seed);
            comes_back::<Setpoint>(seed);
            comes_back::<Wrench>(seed);
            comes_back::<RotorSpeeds>(seed);
            comes_back::<SwapRecord>(seed);
            comes_back::<Monitor>(seed);
        }
    }

    #[test]
    fn another_topics_message_is_not_read() {
        let mut bytes = Vec::new();
        encode(&filled::<Wrench>(1), &mut bytes);
        assert!(decode::<State>(&bytes).is_none() && decode::<RotorSpeeds>(&bytes).is_none());
        assert!(decode::<Wrench>(&[]).is_none());
    }
}
