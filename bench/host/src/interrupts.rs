//! Interrupts that a processor has taken, by kind.

use std::collections::BTreeMap;

use analysis::host::{InterruptCount, InterruptKind};

use crate::machine::Machine;

/// Counters of /proc/interrupts and /proc/softirqs at an instant, for one processor or for all of them together: count
/// and source by kind and name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Interrupts(BTreeMap<(InterruptKind, String), (u64, String)>);

impl Interrupts {
    pub fn read(processor: Option<u64>) -> Self {
        Self::of(&Machine::files(), processor)
    }

    /// Counters of one processor of a machine, or of all of them; none of what cannot be read.
    pub fn of(machine: &Machine, processor: Option<u64>) -> Self {
        let files = [
            (InterruptKind::Hard, "/proc/interrupts"),
            (InterruptKind::Soft, "/proc/softirqs"),
        ];
        let mut all = BTreeMap::new();
        for (kind, path) in files {
            let table = machine.read(path).unwrap_or_default();
            for (name, count, source) in rows(&table, processor) {
                all.insert((kind, name), (count, source));
            }
        }
        Self(all)
    }

    pub fn until(&self, later: &Self) -> Vec<InterruptCount> {
        let since =
            |((kind, name), (count, source)): (&(InterruptKind, String), &(u64, String))| {
                let key = (*kind, name.clone());
                let before = self.0.get(&key).map_or(0, |(before, _)| *before);
                (*count > before).then(|| InterruptCount {
                    kind: *kind,
                    name: name.clone(),
                    source: source.clone(),
                    count: count - before,
                })
            };
        let mut counts: Vec<_> = later.0.iter().filter_map(since).collect();
        counts.sort_by_key(|it| std::cmp::Reverse(it.count));
        counts
    }
}

/// The rows of a table with a column for each processor that is online: name, count, what it comes from.
fn rows(table: &str, processor: Option<u64>) -> Vec<(String, u64, String)> {
    let mut lines = table.lines();
    let header = lines.next().unwrap_or_default().split_ascii_whitespace();
    let wanted = processor.map(|number| format!("CPU{number}"));
    let is_wanted = |name| wanted.as_ref().is_none_or(|wanted| wanted == name);
    let columns: Vec<bool> = header.map(is_wanted).collect();
    let row = |line: &str| {
        let (name, rest) = line.split_once(':')?;
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let (counts, source) = words.split_at_checked(columns.len())?;
        let mut sum = 0;
        for (count, is_wanted) in counts.iter().zip(&columns) {
            let count: u64 = count.parse().ok()?;
            sum += if *is_wanted { count } else { 0 };
        }
        // Before the devices of a numbered one, with commas between them, stand its controller and its line.
        let name = name.trim();
        let devices = match source.split_last() {
            Some((_, before)) if name.parse::<u32>().is_ok() => {
                let more = before.iter().rev().take_while(|word| word.ends_with(','));
                &source[before.len() - more.count()..]
            }
            _ => source,
        };
        Some((name.to_owned(), sum, devices.join(" ")))
    };
    lines.filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::made_up;

    const HARD: &str = "            CPU0       CPU2
  16:          0          3  IO-APIC  16-fasteoi   ehci_hcd:usb1, nvidia
  24:          1        700  PCI-MSIX-0000:00:02.0   1-edge      virtio1-req.0
 LOC:    1000000    2000000  Local timer interrupts
 ERR:          0
";
    const SOFT: &str = "                    CPU0       CPU2\n          HI:          0          0\n       TIMER:         10         20\n";

    fn counted(hard: &str, soft: &str, processor: Option<u64>) -> Interrupts {
        let files = [("proc/interrupts", hard), ("proc/softirqs", soft)];
        let (_root, machine) = made_up(&files);
        Interrupts::of(&machine, processor)
    }

    fn shown(counts: &[InterruptCount]) -> Vec<String> {
        counts
            .iter()
            .map(|it| format!("{:?} {} {} {}", it.kind, it.name, it.source, it.count))
            .collect()
    }

    #[test]
    fn a_processor_is_found_by_its_name_as_some_may_be_offline() {
        let none = Interrupts::default();
        let of = |processor| shown(&none.until(&counted(HARD, SOFT, processor)));
        let expected = [
            "Hard LOC Local timer interrupts 2000000",
            "Hard 24 virtio1-req.0 700",
            "Soft TIMER  20",
            "Hard 16 ehci_hcd:usb1, nvidia 3",
        ];
        assert_eq!(of(Some(2)), expected);
        assert_eq!(of(Some(1)), [""; 0]);
        assert_eq!(of(None)[0], "Hard LOC Local timer interrupts 3000000");
        let later = counted(
            &HARD.replace("700", "705"),
            &SOFT.replace("20", "120"),
            Some(2),
        );
        let since = shown(&counted(HARD, SOFT, Some(2)).until(&later));
        assert_eq!(since, ["Soft TIMER  100", "Hard 24 virtio1-req.0 5"]);
    }
}
