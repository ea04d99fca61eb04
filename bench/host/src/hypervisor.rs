//! Whether a hypervisor runs below, by the same marks that systemd-detect-virt goes by.
//!
//! The processor's own flag exists on x86 alone. Elsewhere firmware tells: DMI on servers, the device tree on boards.

use crate::Machine;
use crate::cpu_times::CpuTimes;

const DMI: [&str; 5] = [
    "product_name",
    "sys_vendor",
    "board_vendor",
    "bios_vendor",
    "product_version",
];
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
        flags.is_none() && CpuTimes::of(machine, None).stolen > 0,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::made_up;

    type Files = Vec<(&'static str, &'static str)>;

    const ARM: (&str, &str) = ("proc/cpuinfo", "processor\t: 0\nFeatures\t: fp asimd\n");
    const TREE: &str = "proc/device-tree/compatible";

    fn arm(path: &'static str, text: &'static str) -> Files {
        vec![ARM, (path, text)]
    }

    fn dmi(vendor: &'static str, product: &'static str) -> Files {
        let product = ("sys/class/dmi/id/product_name", product);
        vec![ARM, ("sys/class/dmi/id/sys_vendor", vendor), product]
    }

    #[test]
    fn a_hypervisor_is_seen_on_every_architecture_and_hardware_by_marks_that_are_missing() {
        let xen = "proc/device-tree/hypervisor/compatible";
        let hidden = ("sys/class/dmi/id/sys_vendor", "QEMU");
        let virtual_machines = vec![
            vec![("proc/cpuinfo", "flags : fpu hypervisor\n")],
            vec![("sys/hypervisor/type", "xen\n")],
            vec![("proc/cpuinfo", "flags : fpu\n"), hidden],
            dmi("Amazon EC2\n", "m7g.large\n"),
            dmi("", "KVM Virtual Machine\n"),
            dmi("Microsoft", "Virtual Machine"),
            arm(xen, "xen,xen-4.17\0xen,xen\0"),
            arm(TREE, "linux,dummy-virt\0"),
            arm("proc/stat", "cpu  10 0 5 80 0 0 0 2 0 0\n"),
        ];
        let hardware = vec![
            vec![("proc/cpuinfo", "flags : fpu vme\n")],
            arm(TREE, "raspberrypi,4-model-b\0brcm,bcm2711\0"),
            dmi("GIGABYTE", "R272-P30"),
            dmi("Amazon EC2\n", "m7g.metal"),
            dmi("Microsoft", "Surface Pro X"),
        ];
        let unknown = vec![
            vec![ARM],
            arm("proc/stat", "cpu  10 0 5 80 0 0 0 0 0 0\n"),
            vec![],
        ];
        for (expected, machines) in [
            (Some(true), virtual_machines),
            (Some(false), hardware),
            (None, unknown),
        ] {
            for files in machines {
                let (_root, machine) = made_up(&files);
                assert_eq!(runs_below(&machine), expected, "{files:?}");
            }
        }
    }
}
