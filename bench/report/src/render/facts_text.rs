//! Parts of the report that several pages share, as text: control laws, their telemetry, early wake-up, interrupts, log.

use crate::host::{InterruptCount, InterruptKind, InterruptSection};
use crate::laws::in_order;
use crate::message_loss::sum;
use crate::phrase::count;
use crate::schema::{LawSection, LogSection, SignalSection};
use crate::timer_lead::LeadSection;
use flight_log::FILE;
use flight_log::facts::{AROUND_MISSES, OFF};
use std::collections::BTreeMap;

/// Which laws flew, in words; nothing in reports from before they could be chosen.
#[must_use]
pub fn laws(laws: &BTreeMap<String, LawSection>) -> String {
    let named = |(role, law): (&str, &LawSection)| {
        let slow = if law.not_real_time {
            ", not real-time"
        } else {
            ""
        };
        let file = law
            .file
            .as_deref()
            .map(|file| format!(" ({}{slow})", file.rsplit('/').next().unwrap_or(file)));
        format!("{role} {}{}", law.name, file.unwrap_or_default())
    };
    in_order(laws).map(named).collect::<Vec<_>>().join(", ")
}

/// What the laws showed, as a table.
#[must_use]
pub fn telemetry(laws: &BTreeMap<String, LawSection>) -> String {
    let number =
        |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.4e}"));
    let mut text = String::new();
    for (role, law) in in_order(laws) {
        for signal in &law.telemetry {
            let SignalSection {
                name,
                unit,
                last,
                min,
                max,
            } = signal;
            let name = format!("{role} {name}");
            let [last, min, max] = [*last, *min, *max].map(number);
            text += format!("  {name:<34} {last:>12} {min:>12} {max:>12}  {unit}").trim_end();
            text += "\n";
        }
    }
    if text.is_empty() {
        return "Telemetry none: no law shows anything of itself\n".into();
    }
    format!(
        "{:<36} {:>12} {:>12} {:>12}\n{text}",
        "Telemetry of the laws", "at the end", "smallest", "largest"
    )
}

impl LeadSection {
    /// As a line of text; of a flight of `ticks`.
    #[must_use]
    pub fn text(&self, ticks: u64) -> String {
        let Self {
            lead_us,
            least_us,
            median_us,
            most_us,
            rehearsal_us,
            timer_p90_us,
            rehearsals,
            ..
        } = self;
        if *lead_us == 0.0 {
            return "Lead none: the plant's timer is set to the beginning of the tick".into();
        }
        let in_flight = if least_us < most_us {
            format!(
                " at take-off, {least_us:.0} to {most_us:.0} us in flight, {median_us:.0} us in the median"
            )
        } else {
            String::new()
        };
        let (rehearsal, rehearsed) = if *rehearsal_us > 0.0 {
            (
                format!(", rehearsal p90 {rehearsal_us:.0} us"),
                format!("rehearsed {rehearsals} of {ticks} ticks"),
            )
        } else {
            (String::new(), "no rehearsals".into())
        };
        format!(
            "Lead {lead_us:.0} us before the tick{in_flight} (before take-off: timer p90 {timer_p90_us:.0} \
             us{rehearsal}); {rehearsed}; waiting took {:.1} % of the loops' processor",
            self.processor_percent
        )
    }
}

impl InterruptSection {
    /// The section of the report for people; empty where nothing was counted.
    #[must_use]
    pub fn text(&self, ticks: u64) -> String {
        if self.counts.is_empty() {
            return String::new();
        }
        let place = self.processor.map_or_else(
            || "all processors".into(),
            |number| format!("processor {number}, the loops'"),
        );
        let mut out = format!("\nInterrupts of {place}    count  per tick\n");
        for InterruptCount {
            kind,
            name,
            source,
            count,
        } in &self.counts
        {
            let softness = if *kind == InterruptKind::Soft {
                "soft "
            } else {
                ""
            };
            let what = format!("{softness}{name} {source}");
            out += &format!(
                "  {:<36} {count:>9} {:>9.3}\n",
                what.trim_end(),
                *count as f64 / ticks.max(1) as f64
            );
        }
        out
    }
}

/// What flight.mcap holds, and what it was not to hold.
#[must_use]
pub fn log(log: &LogSection) -> String {
    if log.kept == OFF {
        return "flight.mcap: none, as asked (recorder.log = off)".into();
    }
    let mut text = match log.files {
        0 | 1 => format!("{FILE}: "),
        files => format!("flight*.mcap: {files} files, "),
    };
    let megabytes = log.file_bytes as f64 / 1e6;
    text += &format!(
        "{} in {megabytes:.1} MB, {} dropped",
        count(sum(&log.messages), "message"),
        sum(&log.dropped)
    );
    text.extend(log.refused.iter().map(|reason| format!(" ({reason})")));
    if log.kept == AROUND_MISSES {
        text += &format!(
            "; {} kept, {} left out as asked",
            count(log.stretches, "excerpt"),
            sum(&log.left_out)
        );
    }
    let removed = sum(&log.removed);
    if removed > 0 {
        text += &format!("; {removed} in older files, removed as asked");
    }
    text
}
