//! Real time as data: what a process requested, what was granted, what a loop used.
//!
//! The role's process makes the requests to the system. Reports and blackboards only know the answers.

use serde::{Deserialize, Serialize};

use crate::layout::{layout, wire_enum};
use crate::role::{Channel, MOST_CHANNELS};

/// How much the user insists on real time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RealtimeMode {
    /// End with an error when a step is refused.
    Require,
    /// Try every step, fly with what is granted, and say what was not.
    #[default]
    Prefer,
    Off,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealtimeSettings {
    pub mode: RealtimeMode,
    /// SCHED_FIFO priority of the plant; later stages come above it.
    pub priority: i32,
    /// The processor for the four loops; `None` takes the highest-numbered one allowed.
    pub cpu: Option<usize>,
    /// How many processors the four loops share: one of [`LOOP_CPUS`].
    pub loop_cpus: usize,
    /// Control channels, of which each is a complete chain of outer loop, inner loop and mixer.
    pub channels: usize,
    /// Of each channel, the first one that flies the same laws.
    pub groups: [Channel; MOST_CHANNELS],
    /// How many processors the channels share: 1, or 2 for channel a and the plant on one and the others on the next.
    pub channel_cpus: usize,
    /// How far ahead of its tick the plant's timer is set.
    pub lead: LeadSetting,
    /// Whether the stages do a warm-up run in the lead.
    pub rehearse: bool,
}

impl RealtimeSettings {
    /// One channel on one processor, and nothing requested of the system.
    pub const OFF: Self = Self {
        mode: RealtimeMode::Off,
        priority: 80,
        cpu: None,
        loop_cpus: 1,
        channels: 1,
        groups: [Channel::A; MOST_CHANNELS],
        channel_cpus: 1,
        lead: LeadSetting::Fixed(0),
        rehearse: false,
    };
}

/// Numbers of processors that the four loops can share.
pub const LOOP_CPUS: [usize; 3] = [1, 2, 4];

/// Longest lead [ns]: the clock is read all the while, by a process that nothing on its processor interrupts.
pub const LONGEST_LEAD_NS: u64 = 5_000_000;

/// How far ahead of its tick the plant's timer is to be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeadSetting {
    /// As far as a measurement before take-off says, and then as the flight shows, where SCHED_FIFO is granted; else
    /// not at all.
    Auto,
    /// So far [ns]; 0 is not at all.
    Fixed(u64),
}

layout! {
    /// The lead at take-off: how far ahead of a tick the timer is set, and what the time is used for.
    ///
    /// Every state's envelope says how far ahead it was set for its tick.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Lead {
        /// How far ahead [ns]; 0 is at the tick.
        pub lead_ns: u64,
        /// 90th percentile of what a warm-up run took before take-off [ns]; 0 where none is held.
        pub rehearsal_ns: u64,
        /// 90th percentile of the timer's lateness as it was measured before take-off [ns]; 0 where it was not.
        pub timer_p90_ns: u64,
    }
}

wire_enum! {
    #[derive(Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum RealtimeStep {
        Scheduler = 0,
        /// One processor for all loops; for the recorder, the others.
        Affinity = 1,
        /// `mlockall`: no page is taken back.
        MemoryLock = 2,
        /// `mallopt`: freed memory stays with the process.
        Malloc = 3,
        /// Stack, heap and shared memory are touched before they are needed.
        Prefault = 4,
        /// Timers of SCHED_OTHER fire without the default 50 us of slack.
        TimerSlack = 5,
        /// /dev/cpu_dma_latency: processors stay out of deep sleep.
        CpuLatency = 6,
    }
}

impl RealtimeStep {
    /// Whether `Mode::Require` insists on it: a machine without the device of the last step has no such sleep.
    pub const fn required(self) -> bool {
        !matches!(self, Self::CpuLatency)
    }
}

layout! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Grant {
        /// 1 when it was requested.
        pub asked: u64,
        /// The request: a priority, a processor, bytes; 0 where a step has no number.
        pub value: u64,
        /// Error number of the refusal; 0 when it was granted.
        pub errno: i64,
    }
}

impl Grant {
    /// Whether it was requested and granted.
    pub const fn granted(&self) -> bool {
        self.asked == 1 && self.errno == 0
    }
}

layout! {
    /// Outcome of every step, in the order of [`RealtimeStep`].
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Grants {
        grants: [Grant; RealtimeStep::ALL.len()],
        /// Scheduling policy in force (0 other, 1 fifo).
        pub policy: u64,
        pub priority: u64,
    }
}

impl Grants {
    pub const fn of(&self, step: RealtimeStep) -> &Grant {
        &self.grants[step as usize]
    }

    /// Records a step's request and the error number of its refusal, 0 if granted.
    pub const fn note(&mut self, step: RealtimeStep, value: u64, errno: i64) {
        self.grants[step as usize] = Grant {
            asked: 1,
            value,
            errno,
        };
    }

    /// Steps that were asked for and refused.
    pub fn refused(&self) -> impl Iterator<Item = RealtimeStep> + '_ {
        RealtimeStep::ALL
            .into_iter()
            .filter(|step| self.of(*step).asked == 1 && !self.of(*step).granted())
    }
}

layout! {
    /// Resources that one thread used between two instants.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Usage {
        pub minor_faults: u64,
        /// Page faults that had to wait for a disk.
        pub major_faults: u64,
        /// Times that it gave the processor up: once for every wait.
        pub voluntary_switches: u64,
        /// Times that the processor was taken from it.
        pub involuntary_switches: u64,
        /// [`NOT_COUNTED`](Self::NOT_COUNTED) in an executable that does not count them.
        pub allocations: u64,
        pub cpu_ns: u64,
    }
}
impl Usage {
    pub const NOT_COUNTED: u64 = u64::MAX;

    pub const fn counted_allocations(&self) -> Option<u64> {
        match self.allocations {
            Self::NOT_COUNTED => None,
            counted => Some(counted),
        }
    }
}
