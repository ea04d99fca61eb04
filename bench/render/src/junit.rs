//! The gates of a flight as JUnit XML, which CI servers show as tests.
//!
//! A test case for each gate, and one for the end of the flight; the words and what they follow from as properties.

use crate::{flight, sentences};
use analysis::schema::Report;
use errors::{Failure, write_text};
use maud::{Markup, PreEscaped, html};
use std::path::Path;

const CLASS: &str = "ironbird.fly";

type Properties = Vec<(String, String)>;

struct Case<'a> {
    name: &'a str,
    properties: Properties,
    failure: Option<String>,
    error: Option<String>,
}

impl<'a> Case<'a> {
    const fn of_the_end(error: Option<String>) -> Self {
        Self {
            name: "end of the flight",
            properties: Properties::new(),
            failure: None,
            error,
        }
    }
}

pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    let mut properties = Properties::new();
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
    let unfinished = (!status.is_over()).then(|| format!("{status}: {}", report.run.ending));
    let mut cases = vec![Case::of_the_end(unfinished)];
    cases.extend(report.verdict.gates.iter().map(|gate| Case {
        name: &gate.name,
        properties: vec![
            ("found".into(), gate.value.clone()),
            ("limit".into(), gate.limit.clone()),
        ],
        failure: (!gate.held).then(|| format!("{} (limit {})", gate.value, gate.limit)),
        error: None,
    }));
    let time = format!("{:.3}", report.ticks.elapsed_s.max(0.0));
    let suite = flight::title(&report.run);
    write_text(path, &document(&suite, Some(&time), &properties, &cases))
}

/// Writes that there was no flight, and why: a file of an earlier one would tell of that.
pub fn write_failure(why: &Failure, path: &Path) -> Result<(), Failure> {
    let end = Case::of_the_end(Some(why.to_string()));
    let none = document("no flight", None, &Properties::new(), &[end]);
    write_text(path, &none)
}

fn document(
    suite: &str,
    time: Option<&str>,
    properties: &Properties,
    cases: &[Case<'_>],
) -> String {
    let tests = cases.len();
    let failures = cases.iter().filter(|case| case.failure.is_some()).count();
    let errors = cases.iter().filter(|case| case.error.is_some()).count();
    let xml = html! {
        (PreEscaped("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"))
        testsuites name="ironbird" tests=(tests) skipped="0" failures=(failures) errors=(errors) {
            testsuite name=(printable(suite)) tests=(tests) skipped="0" failures=(failures) errors=(errors) time=[time] {
                (property_list(properties))
                @for Case { name, properties, failure, error } in cases {
                    testcase name=(printable(name)) classname=(CLASS) {
                        (property_list(properties))
                        @if let Some(why) = failure { failure message=(printable(why)) {} }
                        @if let Some(why) = error { error message=(printable(why)) {} }
                    }
                }
            }
        }
    };
    xml.into_string() + "\n"
}

fn property_list(all: &Properties) -> Markup {
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
        let cases = [None, Some("a < \"b\"\n&\u{1b}c".to_owned())].map(|failure| Case {
            name: "wake > 1",
            properties: vec![("limit".into(), "<= 7".into())],
            failure,
            error: None,
        });
        let xml = document("a & b", Some("1.000"), &Properties::new(), &cases);
        let counts = "tests=\"2\" skipped=\"0\" failures=\"1\" errors=\"0\"";
        for part in [
            &format!("<testsuites name=\"ironbird\" {counts}>"),
            &format!("<testsuite name=\"a &amp; b\" {counts} time=\"1.000\">"),
            &format!("<testcase name=\"wake &gt; 1\" classname=\"{CLASS}\">"),
            "<property name=\"limit\" value=\"&lt;= 7\"></property>",
            "<failure message=\"a &lt; &quot;b&quot; &amp;c\"></failure>",
        ] {
            assert!(xml.contains(part), "{part} is not in\n{xml}");
        }
    }
}
