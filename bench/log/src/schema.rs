//! Builds the Protobuf schemas of the topics from their layouts.
//!
//! Each topic has a `FileDescriptorSet`: the content is the main message, and the envelope is its first field.

use std::collections::BTreeMap;

use messages::header::Header;
use messages::layout::{Field, Kind, Layout as _, Visit as _};
use messages::topic::Topic;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use crate::codec::{CONTENT_NUMBER, ENVELOPE_NUMBER, Logged, is_telemetry};

pub const PACKAGE: &str = "ironbird";

/// Full name of a topic's message, as in `ironbird.State`.
pub fn name<C: Logged>() -> String {
    format!("{PACKAGE}.{}", C::STRUCT)
}

/// Schema of a topic, as its bytes stand in the log.
pub fn descriptor_set<C: Logged>() -> Vec<u8> {
    let mut messages = BTreeMap::new();
    collect(Header::STRUCT, Header::FIELDS, &mut messages);
    collect(C::STRUCT, C::FIELDS, &mut messages);
    let envelope = reference("envelope", ENVELOPE_NUMBER, None, Header::STRUCT);
    let fields = fields(C::FIELDS, CONTENT_NUMBER).into_iter();
    let main = message(C::STRUCT, [envelope].into_iter().chain(fields).collect());
    messages.insert(C::STRUCT, main);
    file_of_topic(<C as Topic>::NAME, messages.into_values().collect())
}

/// The messages of a topic as a file of their own, as its bytes stand in the log.
pub(crate) fn file_of_topic(topic: &str, messages: Vec<DescriptorProto>) -> Vec<u8> {
    let file = vec![file(format!("{PACKAGE}/{topic}.proto"), PACKAGE, messages)];
    FileDescriptorSet { file }.encode_to_vec()
}

pub(crate) fn file(
    name: impl Into<String>,
    package: &str,
    message_type: Vec<DescriptorProto>,
) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        message_type,
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

/// A struct, and those that it is made of.
fn collect(
    name: &'static str,
    layout: &[Field],
    messages: &mut BTreeMap<&'static str, DescriptorProto>,
) {
    for field in logged(layout) {
        if let Kind::Struct { name, fields } = field.kind {
            collect(name, fields, messages);
        }
    }
    messages.insert(name, message(name, fields(layout, ENVELOPE_NUMBER)));
}

pub(crate) fn message(name: &str, field: Vec<FieldDescriptorProto>) -> DescriptorProto {
    DescriptorProto {
        name: Some(name.into()),
        field,
        ..DescriptorProto::default()
    }
}

fn logged(layout: &[Field]) -> impl Iterator<Item = &Field> {
    layout.iter().filter(|field| !is_telemetry(field))
}

fn fields(layout: &[Field], first: u32) -> Vec<FieldDescriptorProto> {
    logged(layout)
        .zip(first..)
        .map(|(field, number)| match field.kind {
            Kind::Struct { name, .. } => reference(field.name, number, field.length, name),
            Kind::F64 => plain(field.name, number, field.length, Type::Double),
            Kind::U64 => plain(field.name, number, field.length, Type::Fixed64),
            Kind::I64 => plain(field.name, number, field.length, Type::Sfixed64),
            Kind::U8 => plain(field.name, number, None, Type::Bytes),
        })
        .collect()
}

pub(crate) fn plain(
    name: &str,
    number: u32,
    length: Option<usize>,
    kind: Type,
) -> FieldDescriptorProto {
    let label = match length {
        Some(_) => Label::Repeated,
        None => Label::Optional,
    };
    FieldDescriptorProto {
        name: Some(name.into()),
        json_name: Some(name.into()),
        number: Some(number.cast_signed()),
        label: Some(label.into()),
        r#type: Some(kind.into()),
        ..FieldDescriptorProto::default()
    }
}

fn reference(
    name: &str,
    number: u32,
    length: Option<usize>,
    message: &str,
) -> FieldDescriptorProto {
    FieldDescriptorProto {
        type_name: Some(format!(".{PACKAGE}.{message}")),
        ..plain(name, number, length, Type::Message)
    }
}
