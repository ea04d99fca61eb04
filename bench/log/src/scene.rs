//! The flight as a 3-D scene: poses and transforms in Foxglove's own schemas.
//!
//! The well-known schemas define the field names and numbers: <https://docs.foxglove.dev/docs/sdk/schemas>.

use messages::content::{Setpoint, State};
use messages::frames::quaternion_wb;
use messages::grid::NS_PER_S;
use prost::Message as _;
use prost_types::field_descriptor_proto::Type;
use prost_types::{FieldDescriptorProto, FileDescriptorSet, Timestamp};

use crate::protobuf::Value::{Message, Text};
use crate::protobuf::{doubles, message};
use crate::schema::{self, plain};

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
        Self {
            pose: 0,
            frame: BODY,
            at_ns,
            position_w_m: state.truth.position_w_m,
            attitude_rad: state.measured.attitude_rad,
        }
    }

    /// Where it should be by a setpoint.
    pub const fn reference(at_ns: u64, setpoint: &Setpoint) -> Self {
        Self {
            pose: 1,
            frame: REFERENCE,
            at_ns,
            position_w_m: setpoint.reference.position_w_m,
            attitude_rad: setpoint.attitude_rad,
        }
    }

    pub fn messages(&self) -> [(usize, Vec<u8>); 2] {
        let timestamp = Timestamp {
            seconds: (self.at_ns / NS_PER_S).cast_signed(),
            nanos: (self.at_ns % NS_PER_S) as i32,
        };
        let time = timestamp.encode_to_vec();
        let position = doubles(&self.position_w_m);
        let orientation = doubles(&quaternion_wb(&self.attitude_rad.into()));
        let (position, orientation) = (Message(&position), Message(&orientation));
        let pose = message(&[(1, position), (2, orientation)]);
        let pose = [(1, Message(&time)), (2, Text(WORLD)), (3, Message(&pose))];
        let transform = [
            (1, Message(&time)),
            (2, Text(WORLD)),
            (3, Text(self.frame)),
            (4, position),
            (5, orientation),
        ];
        [(self.pose, message(&pose)), (2, message(&transform))]
    }
}

/// A message: its name, and its fields in the order of their numbers, each `name:type`.
type MessageSchema = (&'static str, &'static str);

const TIME: [MessageSchema; 1] = [("Timestamp", "seconds:int64 nanos:int32")];

const SCENE: [MessageSchema; 5] = [
    ("Vector3", "x:double y:double z:double"),
    ("Quaternion", "x:double y:double z:double w:double"),
    (
        "Pose",
        "position:.foxglove.Vector3 orientation:.foxglove.Quaternion",
    ),
    (
        "PoseInFrame",
        "timestamp:.google.protobuf.Timestamp frame_id:string pose:.foxglove.Pose",
    ),
    (
        "FrameTransform",
        "timestamp:.google.protobuf.Timestamp parent_frame_id:string child_frame_id:string \
         translation:.foxglove.Vector3 rotation:.foxglove.Quaternion",
    ),
];

/// Schema of `POSE_SCHEMA` and `TRANSFORM_SCHEMA`, as its bytes stand in the log.
pub fn descriptor_set() -> Vec<u8> {
    const TIME_FILE: &str = "google/protobuf/timestamp.proto";
    let message = |(name, fields): &MessageSchema| {
        let fields = (1..).zip(fields.split(' ')).map(field);
        schema::message(name, fields.collect())
    };
    let [time, scene] = [&TIME[..], &SCENE].map(|all| all.iter().map(message).collect());
    let time = schema::file(TIME_FILE, "google.protobuf", time);
    let mut scene = schema::file("foxglove/scene.proto", "foxglove", scene);
    scene.dependency = vec![TIME_FILE.into()];
    let file = vec![time, scene];
    FileDescriptorSet { file }.encode_to_vec()
}

fn field((number, field): (u32, &str)) -> FieldDescriptorProto {
    let (name, kind) = field.split_once(':').unwrap_or((field, ""));
    let (kind, message) = match kind {
        "double" => (Type::Double, None),
        "int32" => (Type::Int32, None),
        "int64" => (Type::Int64, None),
        "string" => (Type::String, None),
        message => (Type::Message, Some(message.to_owned())),
    };
    FieldDescriptorProto {
        type_name: message,
        ..plain(name, number, None, kind)
    }
}
