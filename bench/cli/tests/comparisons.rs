//! `ironbird report diff` on groups of real flights that are alike, and on groups whose outer loop computes longer.

use crate::rig::{Rig, not_tested, rounds};

/// The differences that a comparison of three flights a side reports; none if it is not judged.
fn differences(rig: &Rig, a: &[String], b: &[String]) -> Option<Vec<String>> {
    let args = format!("diff --format json {} -- {}", a.join(" "), b.join(" "));
    let diff = rig.run("report", args).expect(0).json();
    let figures = diff["figures"].as_array().unwrap().iter();
    let different = figures.filter(|it| it["says"] == "more" || it["says"] == "less");
    let names = different.map(|it| it["name"].as_str().unwrap().to_owned());
    (diff["timing"]["says"] == "judged").then(|| names.collect())
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, 10 or more; fewer show nothing"]
fn soak_of_comparisons() {
    if rounds() < 10 {
        return not_tested("comparisons of flights: set IRONBIRD_ROUNDS to 10 or more");
    }
    let rig = Rig::new("alike");
    let (mut alike, mut late) = (Vec::new(), Vec::new());
    for _ in 0..rounds() {
        let mut groups = [const { Vec::new() }; 3];
        for _ in 0..3 {
            let faults = ["", "--fault outer.late=20us@tick1", ""];
            for (group, fault) in groups.iter_mut().zip(faults) {
                rig.run("fly", format!("--duration 3s {fault}"));
                group.push(rig.run_directories().pop().unwrap());
            }
        }
        let [a, b, c] = &groups;
        alike.push(differences(&rig, a, c));
        late.push(differences(&rig, a, b));
    }
    println!("alike: {alike:?}\nthe outer loop computes 20 us longer: {late:?}");
    // With a probability of even one false difference of 10 % (three flights a side), that many and one more.
    let differ = alike.iter().flatten().filter(|names| !names.is_empty());
    assert!(differ.count() as u64 <= rounds() / 10 + 1, "{alike:?}");
    // Three of four find it.
    let figure = "compute.outer p50 [us]".to_owned();
    let is_found = late.iter().flatten().any(|names| names.contains(&figure));
    assert!(is_found, "{late:?}");
}
