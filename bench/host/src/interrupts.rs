//! Interrupts that a processor has taken, by kind.

use std::collections::BTreeMap;

use report::host::{InterruptCount, InterruptKind};

use crate::Machine;

/// Counters of /proc/interrupts and /proc/softirqs at an instant, for one processor or for all of them together.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Interrupts(BTreeMap<(InterruptKind, String), Counted>);

#[derive(Clone, Debug, PartialEq, Eq)]
struct Counted {
    count: u64,
    source: String,
}

impl Interrupts {
    /// Counters of one processor of this machine, or of all of them.
    #[must_use]
    pub fn read(processor: Option<u64>) -> Self {
        Self::of(&Machine::files(), processor)
    }

    /// Counters of one processor of a machine, or of all of them; none of what cannot be read.
    #[must_use]
    pub fn of(machine: &Machine, processor: Option<u64>) -> Self {
        let files = [
            (InterruptKind::Hard, "/proc/interrupts"),
            (InterruptKind::Soft, "/proc/softirqs"),
        ];
        let rows = files.into_iter().flat_map(|(kind, path)| {
            let table = machine.read(path).unwrap_or_default();
            rows(&table, processor)
                .into_iter()
                .map(move |(name, counted)| ((kind, name), counted))
        });
        Self(rows.collect())
    }

    /// What has come since, the most frequent first.
    #[must_use]
    pub fn until(&self, later: &Self) -> Vec<InterruptCount> {
        let grown = |((kind, name), counted): (&(InterruptKind, String), &Counted)| {
            let before = self
                .0
                .get(&(*kind, name.clone()))
                .map_or(0, |before| before.count);
            let count = counted.count.saturating_sub(before);
            (count > 0).then(|| InterruptCount {
                kind: *kind,
                name: name.clone(),
                source: counted.source.clone(),
                count,
            })
        };
        let mut counts: Vec<InterruptCount> = later.0.iter().filter_map(grown).collect();
        counts.sort_by_key(|counted| std::cmp::Reverse(counted.count));
        counts
    }
}

/// The rows of a table with a column for each processor that is online: name, a count for each, what it comes from.
fn rows(table: &str, processor: Option<u64>) -> Vec<(String, Counted)> {
    let mut lines = table.lines();
    let header: Vec<&str> = lines
        .next()
        .unwrap_or_default()
        .split_ascii_whitespace()
        .collect();
    let column = processor.map(|number| format!("CPU{number}"));
    let is_wanted = |place: usize| {
        column
            .as_ref()
            .is_none_or(|name| header.get(place) == Some(&name.as_str()))
    };
    let row = |line: &str| {
        let (name, rest) = line.split_once(':')?;
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        // Rows that are not counted by processor have fewer numbers.
        let counts: Vec<u64> = words
            .iter()
            .take(header.len())
            .map_while(|word| word.parse().ok())
            .collect();
        if counts.len() < header.len() {
            return None;
        }
        let count = counts
            .iter()
            .enumerate()
            .filter(|(place, _)| is_wanted(*place))
            .map(|(_, count)| count)
            .sum();
        let (name, source) = (name.trim(), &words[header.len()..]);
        // Before the devices of a numbered one, with commas between them, stand its controller and its line.
        let is_numbered = name.parse::<u32>().is_ok();
        let before_last = &source[..source.len().saturating_sub(1)];
        let more = before_last
            .iter()
            .rev()
            .take_while(|word| word.ends_with(','))
            .count();
        let from = if is_numbered {
            before_last.len() - more
        } else {
            0
        };
        let source = source[from..].join(" ");
        Some((name.to_owned(), Counted { count, source }))
    };
    lines.filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::Answers;

    const HARD: &str = "            CPU0       CPU2
  16:          0          3  IO-APIC  16-fasteoi   ehci_hcd:usb1, nvidia
  24:          1        700  PCI-MSIX-0000:00:02.0   1-edge      virtio1-req.0
 LOC:    1000000    2000000  Local timer interrupts
 ERR:          0
";
    const SOFT: &str = "                    CPU0       CPU2\n          HI:          0          0\n       TIMER:         10         20\n";

    fn counted(hard: &str, soft: &str, processor: Option<u64>) -> Interrupts {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("proc")).unwrap();
        fs::write(root.path().join("proc/interrupts"), hard).unwrap();
        fs::write(root.path().join("proc/softirqs"), soft).unwrap();
        Interrupts::of(&Machine::under(root.path(), Answers::default()), processor)
    }

    fn told(counts: &[InterruptCount]) -> Vec<String> {
        counts
            .iter()
            .map(|it| format!("{:?} {} {} {}", it.kind, it.name, it.source, it.count))
            .collect()
    }

    #[test]
    fn a_processor_is_found_by_its_name_as_some_may_be_offline() {
        let none = Interrupts::default();
        let of = |processor| told(&none.until(&counted(HARD, SOFT, processor)));
        let expected = [
            "Hard LOC Local timer interrupts 2000000",
            "Hard 24 virtio1-req.0 700",
            "Soft TIMER  20",
            "Hard 16 ehci_hcd:usb1, nvidia 3",
        ];
        assert_eq!(of(Some(2)), expected);
        assert_eq!(of(Some(1)), [""; 0]);
        assert_eq!(of(None)[0], "Hard LOC Local timer interrupts 3000000");
    }

    #[test]
    fn what_has_come_since_is_counted() {
        let before = counted(HARD, SOFT, Some(2));
        let after = counted(
            &HARD.replace("700", "705"),
            &SOFT.replace("20", "120"),
            Some(2),
        );
        assert_eq!(
            told(&before.until(&after)),
            ["Soft TIMER  100", "Hard 24 virtio1-req.0 5"]
        );
    }

    #[test]
    fn this_machine_takes_interrupts() {
        let before = Interrupts::read(None);
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(!before.until(&Interrupts::read(None)).is_empty());
    }
}
