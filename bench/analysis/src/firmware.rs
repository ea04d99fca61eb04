//! The answers of an inner law that is another program, from what the law shows of each tick.

use crate::schema::FirmwareSection;
use crate::series::Latencies;
use errors::Failure;
use messages::content::Wrench;
use messages::role::Role;
use messages::telemetry::{ANSWERS, AnswerOutcome, Signals};

#[derive(Clone, Debug)]
pub struct FirmwareStatistics {
    /// Where the signals of [`ANSWERS`] are; none of a law that is no program.
    places: Option<[usize; ANSWERS.len()]>,
    latencies: Latencies,
    section: FirmwareSection,
    period_s: f64,
}

impl FirmwareStatistics {
    pub fn new(period_s: f64) -> Result<Self, Failure> {
        Ok(Self {
            places: None,
            latencies: Latencies::new()?,
            section: FirmwareSection::default(),
            period_s,
        })
    }

    pub fn set_signals(&mut self, signals: &Signals) {
        self.places = signals.places(Role::Inner, ANSWERS);
    }

    pub fn take(&mut self, tick: u64, wrench: &Wrench) {
        let Some(places) = self.places else {
            return;
        };
        let [outcome, latency_us, late, repeated, disarmed, status] =
            places.map(|place| wrench.telemetry.value[place]);
        let (counts, time_s) = (&mut self.section, tick as f64 * self.period_s);
        let counted = match AnswerOutcome::from_wire(outcome as u64) {
            Some(AnswerOutcome::NotAsked) | None => &mut counts.not_asked,
            Some(AnswerOutcome::Answered) => &mut counts.answered,
            Some(AnswerOutcome::Silent) => &mut counts.silent,
            Some(AnswerOutcome::WrongSize) => &mut counts.wrong_size,
            Some(AnswerOutcome::NotFinite) => &mut counts.not_finite,
            Some(AnswerOutcome::Ended) => {
                counts.ended_at_s.get_or_insert(time_s);
                &mut counts.after_its_end
            }
        };
        *counted += 1;
        counts.late += late as u64;
        counts.repeated += repeated as u64;
        if disarmed > 0.0 {
            counts.disarmed += 1;
            counts.disarmed_at_s.get_or_insert(time_s);
        }
        if status.is_finite() {
            counts.exit_status = Some(status as i64);
        }
        if latency_us.is_finite() {
            self.latencies.record((latency_us * 1e3) as u64);
        }
    }

    /// None of a flight whose inner law is no program.
    pub fn section(&self) -> Option<FirmwareSection> {
        self.places?;
        let mut section = self.section.clone();
        let counted = &self.section;
        section.asked = counted.answered
            + counted.silent
            + counted.wrong_size
            + counted.not_finite
            + counted.after_its_end;
        section.unanswered_percent =
            100.0 * (section.asked - section.answered) as f64 / section.asked.max(1) as f64;
        let us = |q: f64| {
            (!self.latencies.is_empty()).then(|| self.latencies.quantile_ns(q) as f64 / 1e3)
        };
        (section.latency_p50_us, section.latency_p99_us) = (us(0.5), us(0.99));
        (section.latency_p999_us, section.latency_max_us) = (us(0.999), us(1.0));
        Some(section)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::telemetry::Signal;

    const SIGNALS: [Signal; ANSWERS.len()] = {
        let mut signals = [Signal { name: "", unit: "" }; ANSWERS.len()];
        let mut i = 0;
        while i < ANSWERS.len() {
            signals[i].name = ANSWERS[i];
            i += 1;
        }
        signals
    };

    #[test]
    fn each_tick_counts_once_by_its_outcome_and_an_end_has_its_status_and_time() {
        let mut statistics = FirmwareStatistics::new(0.001).unwrap();
        statistics.take(0, &Wrench::default());
        assert_eq!(statistics.section(), None, "a law that is no program");
        statistics.set_signals(&Signals {
            inner: &SIGNALS,
            ..Signals::default()
        });
        let none = f64::NAN;
        for (tick, [outcome, latency_us, late, repeated, disarmed, status]) in [
            [1.0, 100.0, 0.0, 0.0, 0.0, none],
            [1.0, 300.0, 0.0, 1.0, 0.0, none],
            [2.0, none, 0.0, 0.0, 0.0, none],
            [0.0, none, 1.0, 0.0, 0.0, none],
            [3.0, none, 0.0, 0.0, 0.0, none],
            [4.0, none, 0.0, 0.0, 1.0, none],
            [5.0, none, 0.0, 0.0, 0.0, 137.0],
            [5.0, none, 0.0, 0.0, 0.0, 137.0],
        ]
        .into_iter()
        .enumerate()
        {
            let mut wrench = Wrench::default();
            wrench.telemetry.value[..6]
                .copy_from_slice(&[outcome, latency_us, late, repeated, disarmed, status]);
            statistics.take(tick as u64, &wrench);
        }
        let found = statistics.section().unwrap();
        let counts = [
            found.asked,
            found.answered,
            found.silent,
            found.wrong_size,
            found.not_finite,
            found.after_its_end,
            found.not_asked,
            found.late,
            found.repeated,
            found.disarmed,
        ];
        assert_eq!(counts, [7, 2, 1, 1, 1, 2, 1, 1, 1, 1]);
        assert_eq!(
            (found.exit_status, found.ended_at_s),
            (Some(137), Some(0.006))
        );
        assert_eq!(
            (found.disarmed_at_s, found.latency_max_us),
            (Some(0.005), Some(300.0))
        );
        assert!((found.unanswered_percent - 500.0 / 7.0).abs() < 1e-9);
    }
}
