//! The gates of a flight as JUnit XML, which CI servers show as tests.
//!
//! A test case for each gate, and one for the end of the flight; the words and what they follow from as properties.

use std::path::Path;
use std::time::Duration;

use quick_junit::{NonSuccessKind, Property, Report as Document, TestCase, TestCaseStatus, TestSuite};

use crate::schema::{Gate, Report};
use crate::text;
use failure::{Failure, InFile as _, write_text};

/// Group of the test cases.
const CLASS: &str = "ironbird.fly";

/// Writes the gates of a flight.
///
/// # Errors
/// [`Failure`] names the file that cannot be written.
pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    let mut suite = TestSuite::new(text::title(&report.run));
    suite.set_time(Duration::try_from_secs_f64(report.ticks.elapsed_s).unwrap_or_default());
    for (subject, word, why) in report.words.each() {
        suite.add_property(Property::new(subject.to_lowercase(), word));
        suite.add_property(Property::new(format!("{}.why", subject.to_lowercase()), why));
    }
    suite.add_property(("status", report.verdict.status.name()));
    suite.add_property(Property::new("steal_percent", format!("{:.2}", report.steal.percent)));
    suite.add_property(Property::new("build", report.run.build.token()));
    suite.add_test_case(end(report));
    suite.add_test_cases(report.verdict.gates.iter().map(case));
    put(suite, path)
}

/// Writes that there was no flight, and why: a file of an earlier one would tell of that.
///
/// # Errors
/// As [`write`].
pub fn write_failure(why: &Failure, path: &Path) -> Result<(), Failure> {
    let mut suite = TestSuite::new("no flight");
    suite.add_test_case(named("end of the flight", Some((NonSuccessKind::Error, why.to_string()))));
    put(suite, path)
}

/// Whether the flight came to its end in order.
fn end(report: &Report) -> TestCase {
    let verdict = &report.verdict;
    let why = (NonSuccessKind::Error, format!("{}: {}", verdict.status, report.run.ending));
    named("end of the flight", (!verdict.status.is_over()).then_some(why))
}

fn case(gate: &Gate) -> TestCase {
    let found = format!("{} (limit {})", gate.value, gate.limit);
    let mut case = named(&gate.name, (!gate.held).then_some((NonSuccessKind::Failure, found)));
    case.add_property(("found", gate.value.as_str()));
    case.add_property(("limit", gate.limit.as_str()));
    case
}

fn named(name: &str, wrong: Option<(NonSuccessKind, String)>) -> TestCase {
    let status = wrong.map_or_else(TestCaseStatus::success, |(kind, why)| {
        let mut status = TestCaseStatus::non_success(kind);
        status.set_message(why);
        status
    });
    let mut case = TestCase::new(name, status);
    case.set_classname(CLASS);
    case
}

fn put(suite: TestSuite, path: &Path) -> Result<(), Failure> {
    let mut document = Document::new("ironbird");
    document.add_test_suite(suite);
    let text = document.to_string().in_file("write", path)?;
    write_text(path, &text)
}
