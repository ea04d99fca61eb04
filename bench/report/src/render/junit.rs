//! The gates of a flight as JUnit XML, which CI servers show as tests.
//!
//! A test case for each gate, and one for the end of the flight; the words and what they follow from as properties.

use crate::render::flight;
use crate::schema::{Gate, Report};
use errors::{Failure, write_text};
use std::path::Path;

const CLASS: &str = "ironbird.fly";

/// What is wrong with a test case: the tag of the outcome, and a message.
type Wrong = (&'static str, String);
type Properties = Vec<(String, String)>;

/// Writes the gates of a flight.
pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    let mut properties = Properties::new();
    for (subject, word, why) in report.words.each() {
        let subject = subject.to_lowercase();
        properties.push((subject.clone(), word.to_string()));
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
    let status = report.verdict.status.name();
    properties.push(("status".into(), status.into()));
    let steal = format!("{:.2}", report.steal.percent);
    properties.push(("steal_percent".into(), steal));
    properties.push(("build".into(), report.run.build.token().to_string()));
    let mut cases = vec![end(report)];
    cases.extend(report.verdict.gates.iter().map(case));
    let time = format!(" time=\"{:.3}\"", report.ticks.elapsed_s.max(0.0));
    let text = document(&flight::title(&report.run), &time, &properties, &cases);
    write_text(path, &text)
}

/// Writes that there was no flight, and why: a file of an earlier one would tell of that.
pub fn write_failure(why: &Failure, path: &Path) -> Result<(), Failure> {
    let end = Case {
        name: "end of the flight",
        properties: Properties::new(),
        wrong: Some(("error", why.to_string())),
    };
    write_text(path, &document("no flight", "", &Properties::new(), &[end]))
}

struct Case<'a> {
    name: &'a str,
    properties: Properties,
    wrong: Option<Wrong>,
}

/// Whether the flight came to its end in order.
fn end(report: &Report) -> Case<'_> {
    let verdict = &report.verdict;
    let why = || format!("{}: {}", verdict.status, report.run.ending);
    Case {
        name: "end of the flight",
        properties: Properties::new(),
        wrong: (!verdict.status.is_over()).then(|| ("error", why())),
    }
}

fn case(gate: &Gate) -> Case<'_> {
    let found = || format!("{} (limit {})", gate.value, gate.limit);
    Case {
        name: &gate.name,
        properties: vec![
            ("found".into(), gate.value.clone()),
            ("limit".into(), gate.limit.clone()),
        ],
        wrong: (!gate.held).then(|| ("failure", found())),
    }
}

fn document(suite: &str, time: &str, properties: &Properties, cases: &[Case<'_>]) -> String {
    let counted = |tag: &str| {
        let is_of = |case: &&Case<'_>| case.wrong.as_ref().is_some_and(|(of, _)| *of == tag);
        cases.iter().filter(is_of).count()
    };
    let counts = format!(
        "tests=\"{}\" skipped=\"0\" failures=\"{}\" errors=\"{}\"",
        cases.len(),
        counted("failure"),
        counted("error")
    );
    let suite = escaped(suite);
    let mut xml = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <testsuites name=\"ironbird\" {counts}>\n    <testsuite name=\"{suite}\" {counts}{time}>\n"
    );
    xml += &listed(properties, "        ");
    for Case {
        name,
        properties,
        wrong,
    } in cases
    {
        let name = escaped(name);
        xml += &format!("        <testcase name=\"{name}\" classname=\"{CLASS}\">\n");
        xml += &listed(properties, "            ");
        if let Some((tag, message)) = wrong {
            xml += &format!("            <{tag} message=\"{}\"/>\n", escaped(message));
        }
        xml += "        </testcase>\n";
    }
    xml + "    </testsuite>\n</testsuites>\n"
}

fn listed(properties: &Properties, indent: &str) -> String {
    if properties.is_empty() {
        return String::new();
    }
    let line = |(name, value): &(String, String)| {
        let (name, value) = (escaped(name), escaped(value));
        format!("{indent}    <property name=\"{name}\" value=\"{value}\"/>\n")
    };
    let lines: String = properties.iter().map(line).collect();
    format!("{indent}<properties>\n{lines}{indent}</properties>\n")
}

/// A text as the value of an attribute. XML 1.0 has no other control characters than these three.
fn escaped(text: &str) -> String {
    let mut to = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => to += "&amp;",
            '<' => to += "&lt;",
            '>' => to += "&gt;",
            '"' => to += "&quot;",
            '\n' | '\r' | '\t' => to += &format!("&#{};", character as u32),
            '\u{fffe}' | '\u{ffff}' => {}
            _ if character.is_control() => {}
            _ => to.push(character),
        }
    }
    to
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_and_wrong_cases_are_counted() {
        let wrong = [None, Some(("failure", "a < \"b\"\n&\u{1b}c".to_owned()))];
        let cases = wrong.map(|wrong| Case {
            name: "wake > 1",
            properties: vec![("limit".into(), "<= 7".into())],
            wrong,
        });
        let xml = document("a & b", " time=\"1.000\"", &Properties::new(), &cases);
        let counts = "tests=\"2\" skipped=\"0\" failures=\"1\" errors=\"0\"";
        let property = "<property name=\"limit\" value=\"&lt;= 7\"/>";
        let failure = "<failure message=\"a &lt; &quot;b&quot;&#10;&amp;c\"/>";
        for part in [
            format!("<testsuites name=\"ironbird\" {counts}>"),
            format!("<testsuite name=\"a &amp; b\" {counts} time=\"1.000\">"),
            format!("<testcase name=\"wake &gt; 1\" classname=\"{CLASS}\">"),
            property.into(),
            failure.into(),
        ] {
            assert!(xml.contains(&part), "{part} is not in\n{xml}");
        }
    }
}
