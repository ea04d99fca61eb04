//! What a trial found, in words.

use control_api::description::Description;
use messages::role::Role;

use super::{ANSWER, Findings, HOT, INPUTS};

#[must_use]
pub fn render(findings: &Findings, law: &Description, not_real_time: bool) -> String {
    let same = findings.difference.map_or_else(
        || "yes".to_owned(),
        |it| {
            let [one, other] = it.values;
            let what = number(law, it.index);
            format!(
                "NO: {what} of input {} was {one:?} and then {other:?}; it cannot be replayed",
                it.input
            )
        },
    );
    let rehearsed = findings.rehearsed.map_or_else(
        || match (findings.is_copied, findings.difference) {
            (false, _) => "it is not: it cannot be copied".to_owned(),
            (true, Some(_)) => "not tried".to_owned(),
            (true, None) => "yes".to_owned(),
        },
        |it| {
            let ([one, rehearsed], what) = (it.values, number(law, it.index));
            format!(
                "NO: {what} of input {} was {one:?}, and {rehearsed:?} where it had been rehearsed; a copy has to have \
                 memory of its own",
                it.input
            )
        },
    );
    let finite = findings.not_finite.map_or_else(
        || "yes".to_owned(),
        |it| {
            format!(
                "NO: {} of input {} was {}; the rig does not fly such an answer",
                number(law, it.index),
                it.input,
                it.value
            )
        },
    );
    let us = |ns: u64| format!("{:.2} us", ns as f64 / 1e3);
    let [median, p99] = findings.hot_ns.map(us);
    let used = |count: u64| match (count, not_real_time) {
        (0, _) => "none".to_owned(),
        (count, true) => format!("{count} in {HOT} ticks"),
        (count, false) => format!("NO: {count} in {HOT} ticks; each can make a tick late"),
    };
    format!(
        "\nTrial: {INPUTS} inputs drawn at random, then {HOT} ticks of hover\n  same twice   {same}\n  rehearsed    \
         {rehearsed}\n  finite       {finite}\n  warm caches  a tick takes {median} in the median, {p99} at the 99th \
         percentile\n  cold caches  {} in the median\n  allocations  {}\n  page faults  {}\n",
        us(findings.cold_ns),
        findings.usage.counted_allocations().map_or_else(
            || "- (a build with `--features instrumented` counts them)".to_owned(),
            used
        ),
        used(findings.usage.minor_faults + findings.usage.major_faults),
    )
}

/// What the number at an index of an answer is.
fn number(law: &Description, index: usize) -> String {
    if index >= ANSWER {
        let signal = law.telemetry.get(index - ANSWER);
        return signal.map_or_else(
            || format!("telemetry {}", index - ANSWER),
            |signal| signal.name.to_owned(),
        );
    }
    let axis = |i: usize| ["x", "y", "z"][i % 3];
    match (law.role, index) {
        (Role::Mixer, 4) => "saturated".to_owned(),
        (Role::Mixer, rotor) => format!("speed_rad_s of rotor {}", rotor + 1),
        (_, 0) => "thrust_n".to_owned(),
        (Role::Inner, i) => format!("torque_b_nm about {}", axis(i - 1)),
        (_, i) => {
            let what = [
                "attitude_rad",
                "attitude_rate_rad_s",
                "attitude_acceleration_rad_s2",
            ][(i - 1) / 3 % 3];
            format!("{what} of {}", ["roll", "pitch", "yaw"][(i - 1) % 3])
        }
    }
}
