//! The settings of real time.

use host::{Machine, cpu_list};
use messages::blackboards::LOCKSTEP;
use messages::realtime::{LONGEST_LEAD_NS, LeadSetting, RealtimeMode, RealtimeSettings};
use serde::{Deserialize, Serialize};
use toml::Value;

use super::{PaceName, Settings};
use errors::Failure;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealtimeSection {
    pub mode: RealtimeMode,
    pub priority: i32,
    /// Processor of the loops: a number, or "auto".
    pub cpu: Value,
    /// How far ahead of a tick the plant's timer is set [us]: a number, or "auto".
    pub lead_us: Value,
    /// Whether the stages rehearse their tick in the lead.
    pub rehearse: bool,
}

impl Settings {
    /// What to ask the system for.
    ///
    /// # Errors
    /// A usage [`Failure`] where `rt.cpu` is neither a processor nor "auto", or `rt.lead_us` is no lead.
    pub fn realtime(&self) -> Result<RealtimeSettings, Failure> {
        let lead = self.lead()?;
        let cpu = match &self.rt.cpu {
            Value::String(auto) if auto == "auto" => None,
            Value::Integer(cpu) if (0..1024).contains(cpu) => usize::try_from(*cpu).ok(),
            other => {
                return Err(Failure::usage(format!(
                    "rt.cpu = {other}: allowed are a processor's number and \"auto\""
                ))
                .help("`taskset -p $$` shows the processors that this shell may use"));
            }
        };
        // A SCHED_FIFO process that never sleeps is throttled by the kernel, and starves whoever shares its processor.
        if self.flight.pace == PaceName::Lockstep {
            return Ok(RealtimeSettings {
                mode: RealtimeMode::Off,
                priority: self.rt.priority,
                cpu: None,
                lead: LeadSetting::Fixed(0),
                rehearse: false,
            });
        }
        let RealtimeSection {
            mode,
            priority,
            rehearse,
            ..
        } = self.rt;
        Ok(RealtimeSettings {
            mode,
            priority,
            cpu,
            lead,
            rehearse,
        })
    }

    fn lead(&self) -> Result<LeadSetting, Failure> {
        let tick_ns = match self.wall_period_ns() {
            LOCKSTEP => self.sample_time_ns(),
            period_ns => period_ns,
        };
        let most_us = (tick_ns / 2).min(LONGEST_LEAD_NS) / 1000;
        match &self.rt.lead_us {
            Value::String(auto) if auto == "auto" => Ok(LeadSetting::Auto),
            Value::Integer(us) if us.cast_unsigned() <= most_us => Ok(LeadSetting::Fixed(us.cast_unsigned() * 1000)),
            other => Err(Failure::usage(format!(
                "rt.lead_us = {other}: allowed are \"auto\" and whole microseconds from 0 (at the tick) to {most_us}: half \
                 a period, and at most {} ms",
                LONGEST_LEAD_NS / 1_000_000
            ))
            .help("`ironbird fly --print-config` explains every setting")),
        }
    }

    /// Whether the processor that is named for the loops is one of this process': asked where they are to run.
    pub fn check_cpu(&self) -> Result<(), Failure> {
        let named = self
            .rt
            .cpu
            .as_integer()
            .and_then(|cpu| usize::try_from(cpu).ok());
        named.map_or(Ok(()), |cpu| check_cpu(&format!("rt.cpu = {cpu}"), cpu))
    }
}

/// Whether this process may use a processor that the user names as `named`.
pub fn check_cpu(named: &str, cpu: usize) -> Result<(), Failure> {
    let allowed = Machine::files().field("/proc/self/status", "Cpus_allowed_list");
    match allowed {
        Some(list) if !cpu_list(&list).contains(&cpu) => Err(Failure::usage(format!(
            "{named}: this process may use the processors {list}"
        ))
        .help("name one of them with --cpu N, or none: the highest-numbered one is taken")),
        _ => Ok(()),
    }
}
