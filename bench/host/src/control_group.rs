//! Control groups (cgroups, versions 1 and 2) of a process: their limits, and how often the kernel enforced them.
//!
//! A group's limit holds for the groups below it, too. Of a container's groups often only its own is mounted, as the root.

use std::path::Path;

use crate::Machine;

impl Machine {
    /// The smallest limit of a process, `self` or a number, with the file that sets it: of the controller `cpu` in
    /// processors, of `memory` in MiB.
    pub fn group_limit(&self, process: &str, controller: &str) -> Option<(f64, String)> {
        // Version 1 writes a number of this size for no limit; else it is `max` or -1.
        let is_limit = |value: &f64| (0.0..2_f64.powi(62)).contains(value);
        let number = |text: &str| text.parse().ok().filter(is_limit);
        let limit = |group: String| {
            let file = |name: &str| format!("{group}/{controller}.{name}");
            let mut files = ["max", "cfs_quota_us", "limit_in_bytes"]
                .map(file)
                .into_iter();
            let (text, from) = files.find_map(|file| Some((self.read(&file)?, file)))?;
            let period_us = self.read(&file("cfs_period_us"));
            let (limit, period_us) = match text.split_once(' ') {
                Some((limit, period_us)) => (limit, Some(period_us)),
                None => (&*text, period_us.as_deref()),
            };
            let unit = period_us.map_or(Some(f64::from(1 << 20)), number)?;
            Some((number(limit)? / unit, from))
        };
        let groups = self.groups(process, controller).into_iter();
        let limits = groups.filter_map(limit);
        limits.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The files in which the kernel counts what a controller did to the groups of a process.
    pub fn group_counters(&self, process: &str, controller: &str) -> Vec<String> {
        let mut names = Vec::from(["cpu.stat", "memory.events", "memory.oom_control"]);
        names.retain(|name| name.starts_with(controller));
        let groups = self.groups(process, controller).into_iter();
        let files = groups.flat_map(|group| names.iter().map(move |it| format!("{group}/{it}")));
        files.filter(|file| self.read(file).is_some()).collect()
    }

    /// Sum of the counters with some keys, over several files.
    pub fn counted<const N: usize>(&self, files: &[String], keys: [&str; N]) -> [u64; N] {
        let texts: Vec<String> = files.iter().filter_map(|file| self.read(file)).collect();
        let count = |line: &str, key: &str| line.strip_prefix(key)?.trim().parse::<u64>().ok();
        keys.map(|key| {
            let lines = texts.iter().flat_map(|text| text.lines());
            lines.filter_map(|line| count(line, key)).sum()
        })
    }

    /// In how many periods processor quotas were used up, and how long processes then stood still, summed over
    /// processors [us].
    pub fn throttled(&self, counters: &[String]) -> [u64; 2] {
        let keys = ["nr_throttled", "throttled_usec", "throttled_time"];
        let [periods, us, ns] = self.counted(counters, keys);
        [periods, us + ns / 1000]
    }

    /// The directories of the groups of a process with this controller, its own group first.
    pub(crate) fn groups(&self, process: &str, controller: &str) -> Vec<String> {
        let lines = self.read(&format!("/proc/{process}/cgroup"));
        let lines = lines.unwrap_or_default();
        let groups = lines.lines().filter_map(|line| {
            // Number of the hierarchy, its controllers, path of the group. Version 2 names no controllers.
            let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
            let mounts = match controllers {
                "" => ["sys/fs/cgroup/unified", "sys/fs/cgroup"].map(str::to_owned),
                all if all.split(',').any(|it| it == controller) => {
                    [controller, all].map(|mount| format!("sys/fs/cgroup/{mount}"))
                }
                _ => return None,
            };
            let mount = mounts.into_iter().find(|it| self.root.join(it).is_dir())?;
            let above = Path::new(path).ancestors().filter_map(Path::to_str);
            let above = above.map(|group| format!("/{mount}{}", group.trim_end_matches('/')));
            Some(above.collect::<Vec<_>>())
        });
        groups.flatten().collect()
    }
}
