//! Samples what the kernel counts for the control loops and their CPU.

use analysis::finding::Diagnosis;
use analysis::flight_statistics::FlightStatistics;
use analysis::host::{ContainerSection, Host, InterruptSection, Steal};
use errors::Failure;
use host::cpu_times::{CpuTimes, host_of};
use host::interrupts::Interrupts;
use host::sampler::{Watch, fallen};
use host::trace::Trace;
use host::{Machine, doctor};
use ipc::clock::now_ns;
use ipc::instance::Instance;
use messages::blackboards::Status;
use messages::role::{Channel, STAGES};

use super::kernel_trace;
use super::role_statuses::RoleStatuses;

pub struct HostMonitor {
    pub host: Host,
    pub diagnosis: Diagnosis,
    pub counters: Watch,
    /// None where none is requested, and after it could no longer be read.
    trace: Option<Trace>,
    cpu_times: CpuTimes,
    interrupts: Interrupts,
    /// With what the quota had taken before the flight.
    container: ContainerSection,
}

impl HostMonitor {
    pub fn start(
        machine: &Machine,
        roles: &RoleStatuses,
        is_traced: bool,
        instance: &Instance,
    ) -> Result<Self, Failure> {
        let host = host_of(machine);
        let loops = roles.loops(Channel::A);
        let counters = Watch::new(&loops, host.hypervisor != Some(false));
        let (here, plant) = (Machine::files(), loops[0].pid.to_string());
        let limit = |controller| here.group_limit(&plant, controller).map(|(limit, _)| limit);
        let [throttled_periods, throttled_us] = here.throttled(&counters.quota_counters);
        let container = ContainerSection {
            processors: limit("cpu"),
            memory_mib: limit("memory"),
            throttled_periods,
            throttled_us,
        };
        Ok(Self {
            host,
            diagnosis: Diagnosis::of(&doctor::findings(machine)),
            trace: kernel_trace::start(is_traced, instance, counters.processor)?,
            cpu_times: CpuTimes::read(counters.processor),
            interrupts: Interrupts::read(counters.processor),
            container,
            counters,
        })
    }

    /// Samples the counters of the loops of a channel, then classifies the deadlines missed so far.
    pub fn sample(
        &mut self,
        roles: &RoleStatuses,
        channel: Channel,
        statistics: &mut FlightStatistics,
        is_over: bool,
    ) -> Result<(), Failure> {
        let sample = self.counters.sample(channel, &roles.loops(channel));
        let traced = self.read_trace(statistics);
        if let Some(autopsy) = &mut statistics.autopsy {
            // After the last tick it is normal that processes end.
            if !is_over {
                autopsy.sample(sample);
            }
            autopsy.look();
        }
        traced
    }

    /// Takes the last trace and classifies the remaining misses.
    pub fn finish(
        &mut self,
        loops: &[Status; STAGES.len()],
        statistics: &mut FlightStatistics,
        missed: u64,
    ) -> Result<(), Failure> {
        let traced = self.read_trace(statistics);
        if let Some(autopsy) = &mut statistics.autopsy {
            autopsy.ended_stages(fallen(loops), now_ns());
            autopsy.finish(missed);
        }
        traced
    }

    fn read_trace(&mut self, statistics: &mut FlightStatistics) -> Result<(), Failure> {
        let Some(trace) = &mut self.trace else {
            return Ok(());
        };
        let slices = trace.take().map_err(|e| {
            self.trace = None;
            Failure::failed(format!("cannot read the kernel's trace: {e}"))
        })?;
        if let Some(autopsy) = &mut statistics.autopsy {
            autopsy.slices(slices);
        }
        Ok(())
    }

    /// CPU time that the hypervisor took since the start.
    pub fn steal(&self) -> Steal {
        self.cpu_times
            .steal_until(&CpuTimes::read(self.counters.processor))
    }

    /// The limits of the loops' container, and what its processor quota took since the start.
    pub fn container(&self) -> ContainerSection {
        let before = self.container;
        let [periods, us] = Machine::files().throttled(&self.counters.quota_counters);
        ContainerSection {
            throttled_periods: periods.saturating_sub(before.throttled_periods),
            throttled_us: us.saturating_sub(before.throttled_us),
            ..before
        }
    }

    /// Interrupts on the loops' CPU since the start.
    pub fn interrupts(&self) -> InterruptSection {
        let processor = self.counters.processor;
        InterruptSection {
            processor,
            counts: self.interrupts.until(&Interrupts::read(processor)),
        }
    }
}
