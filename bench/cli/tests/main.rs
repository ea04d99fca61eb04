//! Tests of the executable `ironbird`: each file has one subject, and all are one program, which is linked once.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[cfg(feature = "foxglove")]
mod bridge;
mod bumpless;
mod c_laws;
mod documentation;
mod endings;
mod floor;
mod golden;
mod law_trial;
#[cfg(feature = "web")]
mod live_page;
mod margin;
mod message_faults;
mod paper_facts;
mod python;
mod random_flights;
mod recorded;
mod reference_flights;
mod reference_laws;
mod refusals;
mod replay;
mod report_page;
mod restarts;
mod rig;
mod theorem;
mod transcripts;
