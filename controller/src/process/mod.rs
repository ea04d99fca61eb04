//! The processes of the two loops: their laws with their ports.

pub mod inner;
pub mod outer;
