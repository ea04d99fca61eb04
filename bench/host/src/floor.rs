//! The best this machine can do: a bare timer, a raw ring of processes.

pub mod ring;
pub mod timer;

use std::path::Path;

use analysis::host::Steal;
use errors::Failure;
use process::rt::loops_cpu;

use crate::cpu_times::CpuTimes;
use ring::{RingFloor, Work};
use timer::{Schedule, TimerFloor};

pub struct MachineFloor {
    pub timer: TimerFloor,
    pub ring: RingFloor,
    pub refused: Vec<String>,
    /// Time that the hypervisor took meanwhile from the processor of the loops.
    pub steal: Steal,
}

impl MachineFloor {
    pub fn measure(
        schedule: &Schedule,
        work: Vec<Work>,
        executable: &Path,
    ) -> Result<Self, Failure> {
        let processor = Some(schedule.cpu.unwrap_or_else(loops_cpu) as u64);
        let before = CpuTimes::read(processor);
        let timer = timer::measure(schedule)?;
        let ring = ring::measure(schedule, work, executable)?;
        let mut refused = [&timer.standing, &ring.standing]
            .map(|it| it.refused.clone())
            .concat();
        refused.dedup();
        Ok(Self {
            timer,
            ring,
            refused,
            steal: before.steal_until(&CpuTimes::read(processor)),
        })
    }
}
