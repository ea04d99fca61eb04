//! The faults whose greatest strength is searched for, and which strengths to fly next.

use analysis::margin::{Bounds, CALM, Kind, LIMITS, SURVIVES, Search};
use faults::{LONGEST_DELAY_TICKS, Port};
use messages::parameters::{Airframe, Parameter};

use crate::margin::target::Target;

/// Lengths of the patterns of losses, in messages.
const PATTERNS: [u64; 5] = [2, 5, 10, 20, 100];
/// Every this many phases, patterns of losses are flown.
pub const SPARSE: usize = 2;
/// The greatest factor of a loop's gain, in tenths beyond 1.
const MOST_GAIN: u64 = 390;
/// What a torque meets: dividing all of it multiplies the loop's gain and changes nothing else.
const INERTIA: [Parameter; 4] = [
    Parameter::InertiaX,
    Parameter::InertiaY,
    Parameter::InertiaZ,
    Parameter::RotationalDrag,
];

/// A fault of any strength.
#[derive(Clone, Copy, Debug)]
pub struct Question {
    pub kind: Kind,
    target: Target,
}

/// What is measured of some targets, for outages up to `longest` ticks.
pub fn questions(targets: &[Target], longest: u64, airframe: &Airframe) -> Vec<(Question, Search)> {
    let mut all = Vec::new();
    let mut ask = |kind, target: Target, most| {
        let search = Search {
            kind,
            of: target.name(),
            most,
            limits: [None; LIMITS.len()],
            points: Vec::new(),
            repeated: None,
        };
        all.push((Question { kind, target }, search));
    };
    for target in targets {
        ask(Kind::Outage, *target, longest);
    }
    for target in targets {
        let Target::Input(port) = *target else {
            continue;
        };
        ask(Kind::Lag, *target, LONGEST_DELAY_TICKS);
        // Stages ignore a late state: its delay is an outage.
        if !matches!(port, Port::OuterState | Port::InnerState) {
            ask(Kind::Delay, *target, LONGEST_DELAY_TICKS);
        }
        ask(Kind::Loss, *target, 99);
        for of in PATTERNS {
            ask(Kind::Pattern(of), *target, of - 1);
        }
        if port == Port::PlantRotorSpeeds {
            let is_possible = |tenths: &u64| {
                let mut values = inertia(airframe, *tenths);
                values.all(|(parameter, value)| airframe.check(parameter, value).is_ok())
            };
            let most = (1..=MOST_GAIN).take_while(is_possible).last();
            ask(Kind::Gain, *target, most.unwrap_or(0));
        }
    }
    all
}

/// The parameters for a gain of 1 and so many tenths.
fn inertia(airframe: &Airframe, tenths: u64) -> impl Iterator<Item = (Parameter, f64)> {
    let gain = 1.0 + tenths as f64 / 10.0;
    INERTIA
        .into_iter()
        .map(move |it| (it, airframe.get(it) / gain))
}

impl Question {
    /// The fault of a strength from a tick on, as a user types it.
    pub fn fault(&self, strength: u64, from: u64, tick_ns: u64, airframe: &Airframe) -> String {
        let name = self.target.name();
        let what = match self.kind {
            Kind::Outage => return self.target.outage(from, strength, tick_ns),
            Kind::Lag => format!("{name}.lag={strength}"),
            Kind::Delay => format!("{name}.delay={strength}"),
            Kind::Loss => format!("{name}.drop={}", strength as f64 / 100.0),
            Kind::Pattern(of) => format!("{name}.drop={strength}/{of}"),
            Kind::Gain => {
                let values = inertia(airframe, strength);
                let values =
                    values.map(|(parameter, value)| format!("{}={value}", parameter.name()));
                values.collect::<Vec<_>>().join(",")
            }
        };
        format!("{what}@tick{from}")
    }

    pub fn is_of(&self, phase: usize) -> bool {
        !matches!(self.kind, Kind::Pattern(_)) || phase.is_multiple_of(SPARSE)
    }

    /// The ticks of a fault that ends.
    pub fn ticks(&self, strength: u64) -> Option<u64> {
        (self.kind == Kind::Outage).then_some(strength)
    }
}

/// The strengths to fly next, ascending: first some up to the most, then the middle between the last one that holds a
/// limit and the next one that was flown, for each limit of a law that is qualified for it.
pub fn next(search: &Search, qualified: [bool; LIMITS.len()], bounds: &Bounds) -> Vec<u64> {
    if !qualified[SURVIVES] {
        return Vec::new();
    }
    if search.points.is_empty() {
        let decades = (0..).map(|i| 10_u64.pow(i / 2) * [1, 3][(i % 2) as usize]);
        let steps = decades.take_while(|it| *it < search.most);
        return steps.chain([search.most]).collect();
    }
    let gaps = gaps(search, qualified, bounds);
    let mut all: Vec<u64> = gaps.map(|[low, high]| low + (high - low) / 2).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// About how many strengths are left to fly.
pub fn left(search: &Search, qualified: [bool; LIMITS.len()], bounds: &Bounds) -> u64 {
    let first = next(search, qualified, bounds).len() as u64 * u64::from(search.points.is_empty());
    let gaps = gaps(search, qualified, bounds);
    first
        + gaps
            .map(|[low, high]| u64::from((high - low).ilog2()))
            .sum::<u64>()
}

/// Which limits are searched for: of patterns survival alone, and calm of what changes the loop at every tick.
pub fn asked(search: &Search, qualified: [bool; LIMITS.len()]) -> [bool; LIMITS.len()] {
    let is_asked = |limit: usize| match search.kind {
        Kind::Pattern(_) => limit == SURVIVES,
        Kind::Lag | Kind::Delay | Kind::Gain => true,
        Kind::Outage | Kind::Loss => limit != CALM,
    };
    std::array::from_fn(|limit| qualified[limit] && is_asked(limit))
}

/// The last strength that holds a limit and the next one that was flown, where there is more between them.
fn gaps<'a>(
    search: &'a Search,
    qualified: [bool; LIMITS.len()],
    bounds: &'a Bounds,
) -> impl Iterator<Item = [u64; 2]> + 'a {
    let asked = asked(search, qualified);
    let limits = (0..LIMITS.len()).filter(move |limit| asked[*limit]);
    let gap = |limit| {
        let low = search.greatest(limit, bounds);
        let high = match search.points.is_empty() {
            true => search.most,
            false => search.beyond(low)?.at,
        };
        (high - low > 1).then_some([low, high])
    };
    limits.filter_map(gap)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::margin::limits::bounds;
    use analysis::margin::Point;
    use config::Settings;
    use faults::grammar::Fault;

    #[test]
    fn limits_that_share_flights_are_found_to_the_tick() {
        let settings = Settings::resolve(None, &Vec::new()).unwrap();
        let bounds = bounds(&[], &settings).unwrap();
        let airframe = settings.airframe().unwrap();
        for limits in [[52, 171, 307], [0, 0, 2000], [1, 1999, 1999], [0, 0, 0]] {
            let mut search = questions(&[Target::Machine], 2000, &airframe).remove(0).1;
            loop {
                let strengths = next(&search, [true; LIMITS.len()], &bounds);
                if strengths.is_empty() {
                    break;
                }
                for at in strengths {
                    search.take(Point {
                        at,
                        peak_yaw_rad: Some(0.0),
                        peak_m: Some(if at <= limits[0] { 0.01 } else { 1.0 }),
                        recovery_s: Some(if at <= limits[1] { 1.0 } else { 9.0 }),
                        rate_step_increase_rad_s: 0.0,
                        cause: (at > limits[2]).then_some(analysis::margin::Cause::Ground),
                    });
                }
            }
            let found = [0, 1, 2].map(|limit| search.greatest(limit, &bounds));
            assert_eq!(found, limits);
            assert!(search.points.len() < 40, "{}", search.points.len());
        }
    }

    #[test]
    fn every_strength_is_a_fault_as_a_user_types_it() {
        let settings = Settings::resolve(None, &Vec::new()).unwrap();
        let airframe = settings.airframe().unwrap();
        let targets: Vec<Target> = crate::margin::target::all().collect();
        for (question, search) in questions(&targets, 2000, &airframe) {
            for at in [1, search.most] {
                let typed = question.fault(at, 8000, 1_000_000, &airframe);
                let fault: Fault = typed.parse().expect(&typed);
                assert_eq!(fault.from.tick(0.001), 8000, "{typed}");
            }
        }
    }
}
