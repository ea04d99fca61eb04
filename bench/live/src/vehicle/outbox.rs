//! Messages that wait to be sent, and texts for the user among them.

use std::collections::BTreeMap;
use std::time::Duration;

use mavlink::dialects::common::{MavMessage, MavSeverity, STATUSTEXT_DATA};

/// How often deadline misses, and refusals of the same kind, are reported.
const REPORT_EVERY: Duration = Duration::from_secs(1);
/// Refusals of different kinds in that time.
const REFUSALS: usize = 20;
/// Messages that wait to be sent. What is requested beyond them is left out, as if it had been lost on the way.
const BACKLOG: usize = 1024;
const TEXT_BYTES: usize = 50;

#[derive(Debug, Default)]
pub struct Outbox {
    pub messages: Vec<MavMessage>,
    text_id: u16,
    /// When a refusal may be said again.
    quiet_until: BTreeMap<String, Duration>,
}

impl Outbox {
    pub const fn is_full(&self) -> bool {
        self.messages.len() >= BACKLOG
    }

    /// Sends a text, in parts if it is long.
    pub fn say(&mut self, severity: MavSeverity, text: &str) {
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let parts = parts(&text);
        let id = match parts.len() {
            1 => 0,
            _ => {
                self.text_id = self.text_id.checked_add(1).unwrap_or(1);
                self.text_id
            }
        };
        for (chunk_seq, part) in (0..).zip(parts) {
            self.messages.push(MavMessage::STATUSTEXT(STATUSTEXT_DATA {
                severity,
                text: part.into(),
                id,
                chunk_seq,
            }));
        }
    }

    /// Says why something is refused, once a second at most.
    pub fn refuse(&mut self, why: &str, now: Duration) {
        self.quiet_until.retain(|_, until| now < *until);
        if !self.quiet_until.contains_key(why) && self.quiet_until.len() < REFUSALS {
            self.quiet_until.insert(why.to_owned(), now + REPORT_EVERY);
            self.say(MavSeverity::MAV_SEVERITY_WARNING, why);
        }
    }
}

/// A text in parts that a message has room for. A part that is full is not the last one of several.
fn parts(text: &str) -> Vec<&str> {
    let (mut parts, mut rest) = (Vec::new(), text);
    loop {
        let end = rest.floor_char_boundary(TEXT_BYTES);
        let (part, later) = rest.split_at(end);
        parts.push(part);
        rest = later;
        if rest.is_empty() && (part.len() < TEXT_BYTES || parts.len() == 1) {
            return parts;
        }
    }
}
