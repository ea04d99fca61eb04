//! The gates of a flight as JUnit XML, which CI servers show as tests.
//!
//! A test case for each gate, and one for the end of the flight; the words and what they follow from as properties.

use crate::{flight, sentences};
use analysis::schema::{Gate, Report};
use errors::{Failure, write_text};
use flight_log::wall_time::utc;
use maud::{Markup, PreEscaped, html};
use std::path::Path;
use std::time::SystemTime;

type Properties = Vec<(String, String)>;

/// A flight as a suite of tests.
#[derive(Debug, Default)]
pub struct Suite<'a> {
    /// Name of the suite: it is the same in every run, because CI servers compare runs by it.
    pub name: &'a str,
    /// In UTC, as in a report.
    pub started: &'a str,
    /// Name of the machine.
    pub host: &'a str,
    pub elapsed_s: f64,
    pub properties: Properties,
    /// Why the flight did not come to its end.
    pub unfinished: Option<String>,
    pub gates: &'a [Gate],
}

/// Suite of a flight of processes.
pub const FLY: &str = "ironbird.fly";
/// Suite of a simulated flight.
pub const SIMULATE: &str = "ironbird.simulate";

pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    let mut properties = vec![("flown".into(), flight::title(&report.run))];
    for (subject, word, why) in sentences::verdicts(&report.words) {
        let subject = subject.to_lowercase();
        properties.push((subject.clone(), word));
        properties.push((format!("{subject}.why"), why.to_string()));
    }
    if let Some(not_fresh) = &report.deadlines.not_fresh {
        for (name, ticks) in [
            ("ticks_not_fresh", not_fresh.ticks),
            ("ticks_missed", not_fresh.missed),
            ("ticks_stale", not_fresh.stale),
            ("ticks_skipped", not_fresh.skipped),
        ] {
            properties.push((name.into(), ticks.to_string()));
        }
    }
    let status = report.verdict.status;
    properties.push(("status".into(), status.to_string()));
    let steal = format!("{:.2}", report.steal.percent);
    properties.push(("steal_percent".into(), steal));
    properties.push(("build".into(), report.run.build.token().to_string()));
    let suite = Suite {
        name: FLY,
        started: &report.run.started,
        host: &report.run.hostname,
        elapsed_s: report.ticks.elapsed_s.max(0.0),
        properties,
        unfinished: (!status.is_over()).then(|| format!("{status}: {}", report.run.ending)),
        gates: &report.verdict.gates,
    };
    suite.write(path)
}

/// Writes that there was no flight, and why: a file of an earlier one would report that one.
pub fn write_failure(suite: &str, why: &Failure, host: &str, path: &Path) -> Result<(), Failure> {
    let started = &utc(SystemTime::now());
    let unfinished = Some(why.to_string());
    let suite = Suite {
        name: suite,
        started,
        host,
        unfinished,
        ..Suite::default()
    };
    suite.write(path)
}

impl Suite<'_> {
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        write_text(path, &self.document())
    }

    fn document(&self) -> String {
        let (tests, errors) = (1 + self.gates.len(), usize::from(self.unfinished.is_some()));
        let failures = self.gates.iter().filter(|gate| !gate.held).count();
        let time = format!("{:.3}", self.elapsed_s);
        let timestamp = self.started.replacen(' ', "T", 1).replace(" UTC", "");
        let line = PreEscaped("\n");
        let measured = |gate: &Gate| {
            let both = [("found", &gate.value), ("limit", &gate.limit)];
            both.map(|(name, value)| (name.into(), value.clone()))
        };
        let xml = html! {
            (PreEscaped("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"))
            testsuites name="ironbird" tests=(tests) skipped="0" failures=(failures) errors=(errors) { (line)
                testsuite name=(self.name) tests=(tests) skipped="0" failures=(failures) errors=(errors)
                    timestamp=(printable(&timestamp)) hostname=(printable(self.host)) time=(time) { (line)
                    (property_list(&self.properties)) (line)
                    testcase name="end of the flight" classname=(self.name) time=(time) {
                        @if let Some(why) = &self.unfinished { error message=(printable(why)) {} }
                    } (line)
                    // A gate is judged when the flight is over.
                    @for gate in self.gates {
                        testcase name=(printable(&gate.name)) classname=(self.name) time="0.000" {
                            (property_list(&measured(gate)))
                            @if !gate.held {
                                failure message=(printable(&format!("{} (limit {})", gate.value, gate.limit))) {}
                            }
                        } (line)
                    }
                } (line)
            }
        };
        xml.into_string() + "\n"
    }
}

fn property_list(all: &[(String, String)]) -> Markup {
    html! {
        @if !all.is_empty() {
            properties {
                @for (name, value) in all { property name=(name) value=(printable(value)) {} }
            }
        }
    }
}

/// A text as the value of an attribute: XML 1.0 has no control characters, and lines end at blanks there.
fn printable(text: &str) -> String {
    let lines = text.replace(['\n', '\r', '\t'], " ");
    let has_no_place = |c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}');
    lines.replace(has_no_place, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_and_wrong_cases_are_counted() {
        let gates = [true, false].map(|held| Gate {
            name: "wake > 1".into(),
            limit: "<= 7".into(),
            value: "a < \"b\"\n&\u{1b}c".into(),
            held,
            asked: true,
        });
        let suite = Suite {
            name: FLY,
            started: "2026-03-01 14:05:09 UTC",
            host: "a & b",
            elapsed_s: 1.5,
            gates: &gates,
            ..Suite::default()
        };
        let xml = suite.document();
        let counts = "tests=\"3\" skipped=\"0\" failures=\"1\" errors=\"0\"";
        for part in [
            &format!(
                "<testsuites name=\"ironbird\" {counts}>\n<testsuite name=\"{FLY}\" {counts} "
            ),
            "timestamp=\"2026-03-01T14:05:09\" hostname=\"a &amp; b\" time=\"1.500\">\n",
            &format!("\n<testcase name=\"end of the flight\" classname=\"{FLY}\" time=\"1.500\">"),
            &format!("\n<testcase name=\"wake &gt; 1\" classname=\"{FLY}\" time=\"0.000\">"),
            "<property name=\"limit\" value=\"&lt;= 7\"></property>",
            "<failure message=\"a &lt; &quot;b&quot; &amp;c (limit &lt;= 7)\"></failure></testcase>\n</testsuite>",
        ] {
            assert!(xml.contains(part), "{part} is not in\n{xml}");
        }
    }
}
