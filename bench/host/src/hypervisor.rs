//! Whether a hypervisor runs below, by the same marks that systemd-detect-virt goes by.
//!
//! The processor's own flag exists on x86 alone. Elsewhere firmware tells: DMI on servers, the device tree on boards.

use crate::Machine;
use crate::cpu_times::CpuTimes;

/// Where firmware names maker and machine.
const DMI: [&str; 5] = [
    "product_name",
    "sys_vendor",
    "board_vendor",
    "bios_vendor",
    "product_version",
];
/// How the names begin that hypervisors go by there.
const MAKERS: [&str; 14] = [
    "KVM",
    "OpenStack",
    "KubeVirt",
    "Amazon EC2",
    "QEMU",
    "VMware",
    "VMW",
    "innotek GmbH",
    "VirtualBox",
    "Xen",
    "Bochs",
    "Parallels",
    "BHYVE",
    "Hyper-V",
];
/// The same of makers that sell hardware, too: of the machine's name.
const MACHINES: [&str; 3] = [
    "Google Compute Engine",
    "Apple Virtualization",
    "Virtual Machine",
];
/// What machines are called that are let as hardware.
const METAL: &str = ".metal";
/// What the device tree calls machines that QEMU makes up.
const DUMMY: &str = "dummy-virt";

/// Whether a hypervisor runs below; nothing where no mark says so, and none that would is there.
pub(crate) fn runs_below(machine: &Machine) -> Option<bool> {
    let flags = machine.field("/proc/cpuinfo", "flags");
    let dmi = DMI.map(|name| machine.read(&format!("/sys/class/dmi/id/{name}")));
    let tree = machine.read("/proc/device-tree/compatible");
    let marks = [
        flags
            .as_deref()
            .is_some_and(|flags| flags.split(' ').any(|flag| flag == "hypervisor")),
        machine.read("/sys/hypervisor/type").is_some(),
        names_hypervisor(&dmi),
        machine
            .read("/proc/device-tree/hypervisor/compatible")
            .is_some(),
        tree.as_deref().is_some_and(|names| names.contains(DUMMY)),
        // Only a hypervisor tells a kernel of time that it took.
        flags.is_none() && has_steal(machine),
    ];
    if marks.contains(&true) {
        return Some(true);
    }
    let would_tell = flags.is_some() || tree.is_some() || dmi.iter().any(Option::is_some);
    would_tell.then_some(false)
}

fn names_hypervisor(dmi: &[Option<String>; DMI.len()]) -> bool {
    let [product, ..] = dmi;
    if product.as_deref().is_some_and(|name| name.ends_with(METAL)) {
        return false;
    }
    let begins = |name: &String, known: &[&str]| known.iter().any(|known| name.starts_with(known));
    dmi.iter().flatten().any(|name| begins(name, &MAKERS))
        || product.iter().any(|name| begins(name, &MACHINES))
}

fn has_steal(machine: &Machine) -> bool {
    CpuTimes::of(machine, None).stolen() > 0
}

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::Answers;

    use super::*;

    fn of(files: &[(&str, &str)]) -> Option<bool> {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        runs_below(&Machine::under(root.path(), Answers::default()))
    }

    const ARM: (&str, &str) = ("proc/cpuinfo", "processor\t: 0\nFeatures\t: fp asimd\n");

    #[test]
    fn a_hypervisor_is_seen_on_every_architecture() {
        let marks: [&[(&str, &str)]; 9] = [
            &[("proc/cpuinfo", "flags : fpu hypervisor\n")],
            &[("sys/hypervisor/type", "xen\n")],
            &[
                ARM,
                ("sys/class/dmi/id/sys_vendor", "Amazon EC2\n"),
                ("sys/class/dmi/id/product_name", "m7g.large\n"),
            ],
            &[
                ARM,
                ("sys/class/dmi/id/product_name", "KVM Virtual Machine\n"),
            ],
            &[
                ARM,
                ("sys/class/dmi/id/sys_vendor", "Microsoft"),
                ("sys/class/dmi/id/product_name", "Virtual Machine"),
            ],
            &[
                ARM,
                (
                    "proc/device-tree/hypervisor/compatible",
                    "xen,xen-4.17\0xen,xen\0",
                ),
            ],
            &[ARM, ("proc/device-tree/compatible", "linux,dummy-virt\0")],
            &[
                ARM,
                (
                    "proc/stat",
                    "cpu  10 0 5 80 0 0 0 2 0 0\ncpu0 10 0 5 80 0 0 0 2 0 0\n",
                ),
            ],
            // One that hides its flag.
            &[
                ("proc/cpuinfo", "flags : fpu\n"),
                ("sys/class/dmi/id/sys_vendor", "QEMU"),
            ],
        ];
        for files in marks {
            assert_eq!(of(files), Some(true), "{files:?}");
        }
    }

    #[test]
    fn hardware_is_known_by_what_would_tell_and_does_not() {
        let marks: [&[(&str, &str)]; 5] = [
            &[("proc/cpuinfo", "flags : fpu vme\n")],
            &[
                ARM,
                (
                    "proc/device-tree/compatible",
                    "raspberrypi,4-model-b\0brcm,bcm2711\0",
                ),
            ],
            &[
                ARM,
                ("sys/class/dmi/id/sys_vendor", "GIGABYTE"),
                ("sys/class/dmi/id/product_name", "R272-P30"),
            ],
            &[
                ARM,
                ("sys/class/dmi/id/sys_vendor", "Amazon EC2"),
                ("sys/class/dmi/id/product_name", "m7g.metal"),
            ],
            &[
                ARM,
                ("sys/class/dmi/id/sys_vendor", "Microsoft"),
                ("sys/class/dmi/id/product_name", "Surface Pro X"),
            ],
        ];
        for files in marks {
            assert_eq!(of(files), Some(false), "{files:?}");
        }
    }

    #[test]
    fn what_nothing_tells_is_not_known() {
        assert_eq!(of(&[ARM]), None);
        assert_eq!(
            of(&[ARM, ("proc/stat", "cpu  10 0 5 80 0 0 0 0 0 0\n")]),
            None
        );
        assert_eq!(of(&[]), None);
    }
}
