//! Whether a hypervisor runs below, by the same marks that systemd-detect-virt goes by.
//!
//! The processor's own flag exists on x86 alone. Elsewhere firmware tells: DMI on servers, the device tree on boards.

use crate::cpu_times::CpuTimes;
use crate::machine::Machine;

const DMI: [&str; 3] = ["sys_vendor", "board_vendor", "bios_vendor"];
const MAKERS: &str = "KVM|OpenStack|KubeVirt|Amazon EC2|QEMU|VMware|VMW|innotek GmbH|VirtualBox|Xen|Bochs|\
    Parallels|BHYVE|Hyper-V";
/// Product names of makers that also sell hardware.
const PRODUCTS: &str = "Google Compute Engine|Apple Virtualization|Virtual Machine";
/// End of the product names of hardware that is for rent.
const METAL: &str = ".metal";
/// Name of QEMU's machines in the device tree.
const DUMMY: &str = "dummy-virt";

impl Machine {
    /// Whether a hypervisor runs below; none if nothing says so, and nothing is there that would.
    pub fn hypervisor(&self) -> Option<bool> {
        let dmi = |name: &str| self.read(&format!("/sys/class/dmi/id/{name}"));
        let flags = self.field("/proc/cpuinfo", "flags");
        let tree = self.read("/proc/device-tree/compatible");
        let product = dmi("product_name");
        let makers = DMI.map(dmi).into_iter().chain([dmi("product_version")]);
        let names: Vec<String> = makers.chain([product.clone()]).flatten().collect();
        let begins =
            |name: &str, known: &str| known.split('|').any(|known| name.starts_with(known));
        let named = names.iter().any(|name| begins(name, MAKERS))
            || product.iter().any(|name| begins(name, PRODUCTS));
        let is_hardware = product.as_ref().is_some_and(|name| name.ends_with(METAL));
        let has = |text: &Option<String>, word: &str| {
            let mut words = text.iter().flat_map(|text| text.split([' ', ',', '\0']));
            words.any(|it| it == word)
        };
        let marks = [
            has(&flags, "hypervisor"),
            self.read("/sys/hypervisor/type").is_some(),
            named && !is_hardware,
            self.read("/proc/device-tree/hypervisor/compatible")
                .is_some(),
            has(&tree, DUMMY),
            // Only a hypervisor reports stolen time to a kernel.
            flags.is_none() && CpuTimes::of(self, None).stolen > 0,
        ];
        let would_tell = flags.is_some() || tree.is_some() || !names.is_empty();
        match marks.contains(&true) {
            true => Some(true),
            false => would_tell.then_some(false),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::machine::tests::made_up;

    const ARM: (&str, &str) = ("proc/cpuinfo", "processor\t: 0\nFeatures\t: fp asimd\n");
    const CPU: &str = "proc/cpuinfo";
    const TREE: &str = "proc/device-tree/compatible";
    const XEN: &str = "proc/device-tree/hypervisor/compatible";
    const VENDOR: &str = "sys/class/dmi/id/sys_vendor";
    const PRODUCT: &str = "sys/class/dmi/id/product_name";

    #[test]
    fn a_hypervisor_is_seen_on_every_architecture_and_hardware_by_marks_that_are_missing() {
        // Without its own, a machine has the processor file of an ARM board.
        let virtual_machines: &[&[_]] = &[
            &[(CPU, "flags : fpu hypervisor\n")],
            &[("sys/hypervisor/type", "xen\n")],
            &[(CPU, "flags : fpu\n"), (VENDOR, "QEMU")],
            &[(VENDOR, "Amazon EC2\n"), (PRODUCT, "m7g.large\n")],
            &[(VENDOR, ""), (PRODUCT, "KVM Virtual Machine\n")],
            &[(VENDOR, "Microsoft"), (PRODUCT, "Virtual Machine")],
            &[(XEN, "xen,xen-4.17\0xen,xen\0")],
            &[(TREE, "linux,dummy-virt\0")],
            &[("proc/stat", "cpu  10 0 5 80 0 0 0 2 0 0\n")],
        ];
        let hardware: &[&[_]] = &[
            &[(CPU, "flags : fpu vme\n")],
            &[(TREE, "raspberrypi,4-model-b\0brcm,bcm2711\0")],
            &[(VENDOR, "GIGABYTE"), (PRODUCT, "R272-P30")],
            &[(VENDOR, "Amazon EC2\n"), (PRODUCT, "m7g.metal")],
            &[(VENDOR, "Microsoft"), (PRODUCT, "Surface Pro X")],
        ];
        let unknown: &[&[_]] = &[&[], &[("proc/stat", "cpu  10 0 5 80 0 0 0 0 0 0\n")]];
        for (expected, machines) in [
            (Some(true), virtual_machines),
            (Some(false), hardware),
            (None, unknown),
        ] {
            for files in machines {
                let (_root, machine) = made_up(&[&[ARM], *files].concat());
                assert_eq!(machine.hypervisor(), expected, "{files:?}");
            }
        }
        let (_root, empty) = made_up(&[]);
        assert_eq!(empty.hypervisor(), None, "without /proc/cpuinfo");
    }
}
