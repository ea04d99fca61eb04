//! The flight as a 3-D scene: poses and transforms in Foxglove's own schemas.
//!
//! The well-known schemas define the field names and numbers: <https://docs.foxglove.dev/docs/sdk/schemas>.

use messages::content::Measured;
use messages::content::{Setpoint, State};
use messages::frames::quaternion_wb;
use messages::grid::NS_PER_S;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};

pub const WORLD: &str = "world";
pub const BODY: &str = "body";
/// Name of the frame in which the airframe should be.
pub const REFERENCE: &str = "reference";

/// Full name of the schema of a pose.
pub const POSE_SCHEMA: &str = "foxglove.PoseInFrame";
/// Full name of the schema of a transform.
pub const TRANSFORM_SCHEMA: &str = "foxglove.FrameTransform";

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

#[derive(Clone, PartialEq, prost::Message)]
struct Vector3 {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

#[derive(Clone, PartialEq, prost::Message)]
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

#[derive(Clone, PartialEq, prost::Message)]
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

/// Where something is at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Its pose's place in [`CHANNELS`].
    pose: usize,
    frame: &'static str,
    /// When, on the clock of the log [ns].
    at_ns: u64,
    /// Where, world frame [m].
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

    /// When, on the clock of the log [ns].
    pub const fn at_ns(&self) -> u64 {
        self.at_ns
    }

    /// Its messages, each with its place in [`CHANNELS`].
    pub fn messages(&self) -> [(usize, Vec<u8>); 2] {
        [(self.pose, self.pose()), (2, self.transform())]
    }

    fn timestamp(&self) -> Timestamp {
        let seconds = (self.at_ns / NS_PER_S).cast_signed();
        Timestamp {
            seconds,
            nanos: (self.at_ns % NS_PER_S) as i32,
        }
    }

    fn position(&self) -> Vector3 {
        let [x, y, z] = self.position_w_m;
        Vector3 { x, y, z }
    }

    fn orientation(&self) -> Quaternion {
        let [x, y, z, w] = quaternion_wb(&self.attitude_rad.into());
        Quaternion { x, y, z, w }
    }

    fn pose(&self) -> Vec<u8> {
        let pose = Pose {
            position: Some(self.position()),
            orientation: Some(self.orientation()),
        };
        let message = PoseInFrame {
            timestamp: Some(self.timestamp()),
            frame_id: WORLD.into(),
            pose: Some(pose),
        };
        message.encode_to_vec()
    }

    fn transform(&self) -> Vec<u8> {
        let message = FrameTransform {
            timestamp: Some(self.timestamp()),
            parent_frame_id: WORLD.into(),
            child_frame_id: self.frame.into(),
            translation: Some(self.position()),
            rotation: Some(self.orientation()),
        };
        message.encode_to_vec()
    }
}

/// Schema of [`POSE_SCHEMA`] and [`TRANSFORM_SCHEMA`], as its bytes stand in the log.
pub fn descriptor_set() -> Vec<u8> {
    const TIMESTAMP: &str = ".google.protobuf.Timestamp";
    let time = message(
        "Timestamp",
        &[("seconds", Type::Int64, ""), ("nanos", Type::Int32, "")],
    );
    let double = |names: &[&'static str]| -> Vec<_> {
        names.iter().map(|name| (*name, Type::Double, "")).collect()
    };
    let vector = message("Vector3", &double(&["x", "y", "z"]));
    let quaternion = message("Quaternion", &double(&["x", "y", "z", "w"]));
    let pose = message(
        "Pose",
        &[
            ("position", Type::Message, ".foxglove.Vector3"),
            ("orientation", Type::Message, ".foxglove.Quaternion"),
        ],
    );
    let pose_in_frame = message(
        "PoseInFrame",
        &[
            ("timestamp", Type::Message, TIMESTAMP),
            ("frame_id", Type::String, ""),
            ("pose", Type::Message, ".foxglove.Pose"),
        ],
    );
    let transform = message(
        "FrameTransform",
        &[
            ("timestamp", Type::Message, TIMESTAMP),
            ("parent_frame_id", Type::String, ""),
            ("child_frame_id", Type::String, ""),
            ("translation", Type::Message, ".foxglove.Vector3"),
            ("rotation", Type::Message, ".foxglove.Quaternion"),
        ],
    );
    let time_file = file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        vec![time],
    );
    let mut own = file(
        "foxglove/scene.proto",
        "foxglove",
        vec![vector, quaternion, pose, pose_in_frame, transform],
    );
    own.dependency = vec!["google/protobuf/timestamp.proto".into()];
    FileDescriptorSet {
        file: vec![time_file, own],
    }
    .encode_to_vec()
}

fn file(name: &str, package: &str, message_type: Vec<DescriptorProto>) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        message_type,
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

/// A message whose fields are numbered from 1.
fn message(name: &str, fields: &[(&str, Type, &str)]) -> DescriptorProto {
    let field = |(number, (name, kind, of)): (i32, &(&str, Type, &str))| FieldDescriptorProto {
        name: Some((*name).into()),
        json_name: Some((*name).into()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some((*kind).into()),
        type_name: (!of.is_empty()).then(|| (*of).into()),
        ..FieldDescriptorProto::default()
    };
    DescriptorProto {
        name: Some(name.into()),
        field: (1..).zip(fields).map(field).collect(),
        ..DescriptorProto::default()
    }
}
