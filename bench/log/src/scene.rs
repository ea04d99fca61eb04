//! The flight as a 3-D scene: poses and transforms in Foxglove's own schemas.
//!
//! The well-known schemas define the field names and numbers: <https://docs.foxglove.dev/docs/sdk/schemas>.

use messages::content::{Measured, Setpoint, State};
use messages::frames::quaternion_wb;
use messages::grid::NS_PER_S;
use prost::Message as _;
use prost_types::field_descriptor_proto::Type;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};

use crate::schema::plain;

pub const WORLD: &str = "world";
const BODY: &str = "body";
const REFERENCE: &str = "reference";

const POSE_SCHEMA: &str = "foxglove.PoseInFrame";
const TRANSFORM_SCHEMA: &str = "foxglove.FrameTransform";

/// Channels of the scene with their schemas: where the airframe is, where it should be, and both as frames.
pub const CHANNELS: [(&str, &str); 3] = [
    ("pose/actual", POSE_SCHEMA),
    ("pose/reference", POSE_SCHEMA),
    ("transforms", TRANSFORM_SCHEMA),
];

/// Flight time between two places of the scene [ns].
const EVERY_NS: u64 = 40_000_000;

/// Ticks between two places of the scene, with ticks of `sample_time_ns` [ns].
pub fn every_ticks(sample_time_ns: u64) -> u64 {
    (EVERY_NS / sample_time_ns.max(1)).max(1)
}

#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Vector3 {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Quaternion {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Pose {
    #[prost(message, optional, tag = "1")]
    position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<Quaternion>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    parent_frame_id: String,
    #[prost(string, tag = "3")]
    child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<Quaternion>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    pose: usize,
    frame: &'static str,
    /// When, on the clock of the log [ns].
    pub at_ns: u64,
    position_w_m: [f64; 3],
    /// Roll, pitch, yaw [rad].
    attitude_rad: [f64; 3],
}

impl Placed {
    pub const fn airframe(at_ns: u64, state: &State) -> Self {
        let Measured {
            position_w_m,
            attitude_rad,
            ..
        } = state.measured;
        Self {
            pose: 0,
            frame: BODY,
            at_ns,
            position_w_m,
            attitude_rad,
        }
    }

    /// Where it should be by a setpoint.
    pub const fn reference(at_ns: u64, setpoint: &Setpoint) -> Self {
        let Setpoint {
            ref reference,
            attitude_rad,
            ..
        } = *setpoint;
        Self {
            pose: 1,
            frame: REFERENCE,
            at_ns,
            position_w_m: reference.position_w_m,
            attitude_rad,
        }
    }

    pub fn messages(&self) -> [(usize, Vec<u8>); 2] {
        let timestamp = Some(Timestamp {
            seconds: (self.at_ns / NS_PER_S).cast_signed(),
            nanos: (self.at_ns % NS_PER_S) as i32,
        });
        let [x, y, z] = self.position_w_m;
        let position = Some(Vector3 { x, y, z });
        let [x, y, z, w] = quaternion_wb(&self.attitude_rad.into());
        let orientation = Some(Quaternion { x, y, z, w });
        let pose = PoseInFrame {
            timestamp,
            frame_id: WORLD.into(),
            pose: Some(Pose {
                position,
                orientation,
            }),
        };
        let transform = FrameTransform {
            timestamp,
            parent_frame_id: WORLD.into(),
            child_frame_id: self.frame.into(),
            translation: position,
            rotation: orientation,
        };
        [
            (self.pose, pose.encode_to_vec()),
            (2, transform.encode_to_vec()),
        ]
    }
}

/// A message: its name, and its fields with their types, numbered from 1.
type MessageSchema = (&'static str, &'static [(&'static str, Type, &'static str)]);

const TIMESTAMP: &str = ".google.protobuf.Timestamp";
const VECTOR: &str = ".foxglove.Vector3";
const QUATERNION: &str = ".foxglove.Quaternion";

const TIME: [MessageSchema; 1] = [(
    "Timestamp",
    &[("seconds", Type::Int64, ""), ("nanos", Type::Int32, "")],
)];

const SCENE: [MessageSchema; 5] = [
    (
        "Vector3",
        &[
            ("x", Type::Double, ""),
            ("y", Type::Double, ""),
            ("z", Type::Double, ""),
        ],
    ),
    (
        "Quaternion",
        &[
            ("x", Type::Double, ""),
            ("y", Type::Double, ""),
            ("z", Type::Double, ""),
            ("w", Type::Double, ""),
        ],
    ),
    (
        "Pose",
        &[
            ("position", Type::Message, VECTOR),
            ("orientation", Type::Message, QUATERNION),
        ],
    ),
    (
        "PoseInFrame",
        &[
            ("timestamp", Type::Message, TIMESTAMP),
            ("frame_id", Type::String, ""),
            ("pose", Type::Message, ".foxglove.Pose"),
        ],
    ),
    (
        "FrameTransform",
        &[
            ("timestamp", Type::Message, TIMESTAMP),
            ("parent_frame_id", Type::String, ""),
            ("child_frame_id", Type::String, ""),
            ("translation", Type::Message, VECTOR),
            ("rotation", Type::Message, QUATERNION),
        ],
    ),
];

/// Schema of `POSE_SCHEMA` and `TRANSFORM_SCHEMA`, as its bytes stand in the log.
pub fn descriptor_set() -> Vec<u8> {
    const TIME_FILE: &str = "google/protobuf/timestamp.proto";
    let time = file(TIME_FILE, "google.protobuf", &TIME);
    let mut scene = file("foxglove/scene.proto", "foxglove", &SCENE);
    scene.dependency = vec![TIME_FILE.into()];
    FileDescriptorSet {
        file: vec![time, scene],
    }
    .encode_to_vec()
}

fn file(name: &str, package: &str, messages: &[MessageSchema]) -> FileDescriptorProto {
    let field = |(number, (name, kind, of)): (u32, &(&str, Type, &str))| FieldDescriptorProto {
        type_name: (!of.is_empty()).then(|| (*of).into()),
        ..plain(name, number, None, *kind)
    };
    let message = |(name, fields): &MessageSchema| DescriptorProto {
        name: Some((*name).into()),
        field: (1..).zip(*fields).map(field).collect(),
        ..DescriptorProto::default()
    };
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        message_type: messages.iter().map(message).collect(),
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}
