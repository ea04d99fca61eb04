//! Which command of a tick is taken, of several channels that may fly different laws.

use std::cmp::Reverse;

use messages::channels::{Switchover, SwitchoverReason};
use messages::content::{NO_TICK, ROTORS, RotorSpeeds, TakenCommand};
use messages::header::Message;
use messages::history::UNDISTURBED;
use messages::layout::Visit as _;
use messages::role::{Channel, MOST_CHANNELS, Role};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    pub channel: Channel,
    pub tick: u64,
    /// Tick from which on it may act: the next one, if it was sent before that began.
    pub effective_tick: u64,
    /// Whether every stage computed it from the state of the tick.
    pub is_fresh: bool,
    /// History of its mixer's state, and so of all that it was computed from ([`messages::history`]).
    pub history: u64,
    pub seq: u64,
    pub command: RotorSpeeds,
}

impl Candidate {
    /// A command that may act from a tick on; none of the last one of a mixer, which answers no wrench.
    pub fn of(
        channel: Channel,
        message: &Message<RotorSpeeds>,
        effective_tick: u64,
    ) -> Option<Self> {
        let Message { envelope, content } = message;
        (envelope.stamps_of(Role::Mixer).receive_ns > 0).then(|| Self {
            channel,
            tick: envelope.tick,
            effective_tick,
            is_fresh: envelope.input_tick == [envelope.tick; 3],
            history: envelope.law_state.after,
            seq: envelope.seq,
            command: *content,
        })
    }

    /// The record that it was taken and acts from a tick on.
    pub const fn taken(&self, acts_from: u64) -> TakenCommand {
        TakenCommand {
            of_tick: self.tick,
            channel: self.channel as u64,
            seq: self.seq,
            acts_from,
            is_offered: 1,
        }
    }

    /// The record that it was refused when it was read.
    pub const fn refused(&self) -> TakenCommand {
        TakenCommand {
            is_offered: 0,
            ..self.taken(NO_TICK)
        }
    }

    pub(crate) const fn is_on_time(&self) -> bool {
        self.effective_tick == self.tick + 1
    }

    /// Whether it is fresh and on time.
    pub const fn is_usable(&self) -> bool {
        self.is_on_time() && self.is_fresh
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Selection {
    pub chosen: Candidate,
    /// Whether another usable command has the same history, and can be compared.
    pub is_compared: bool,
    /// Whether one of those differs in a bit.
    pub differs: bool,
    /// The channel that two others with the same history contradict.
    pub outvoted: Option<Channel>,
}

/// Chooses the command of a tick: one that may act earlier before any other, then one that is fresh, one with an undisturbed
/// history, that of the majority of three with the same history, and then that of the first channel. The candidates are in
/// the order of their channels. Commands with different histories follow from other states or inputs: they are not compared.
pub fn select(candidates: &[Candidate]) -> Option<Selection> {
    let rank = |it: &Candidate| {
        let is_undisturbed = it.history == UNDISTURBED;
        (Reverse(it.effective_tick), it.is_fresh, is_undisturbed)
    };
    let best = candidates.iter().map(rank).max()?;
    let same = |a: &Candidate, b: &Candidate| a.command.is_same(&b.command);
    let rivals = || candidates.iter().filter(|it| rank(it) == best);
    let peers = |it: &Candidate| {
        let it = *it;
        rivals().filter(move |other| other.channel != it.channel && other.history == it.history)
    };
    let is_contradicted =
        |it: &Candidate| peers(it).count() == 2 && !peers(it).any(|other| same(it, other));
    let place = rivals().position(|it| !is_contradicted(it));
    // Where all three differ, none has a majority.
    let chosen = *rivals().nth(place.unwrap_or(0))?;
    let is_compared = chosen.is_usable() && peers(&chosen).next().is_some();
    let differs = is_compared && peers(&chosen).any(|it| !same(it, &chosen));
    let outvoted = rivals().find(|it| place.is_some() && differs && is_contradicted(it));
    Some(Selection {
        chosen,
        is_compared,
        differs,
        outvoted: outvoted.map(|it| it.channel),
    })
}

/// The channels of a flight, and which of them fly the same laws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrangement {
    pub channels: usize,
    /// Of each channel, the first one with the same laws: they are a group, whose commands are the same.
    pub groups: [Channel; MOST_CHANNELS],
    /// Where another group takes over; nothing if it only does so on request.
    pub simplex: Option<SimplexLimits>,
}

impl Arrangement {
    /// Channels with the same laws.
    pub const fn alike(channels: usize) -> Self {
        Self {
            channels,
            groups: [Channel::A; MOST_CHANNELS],
            simplex: None,
        }
    }

    pub const fn group(&self, channel: Channel) -> Channel {
        self.groups[channel as usize]
    }

    /// The first channel of each group.
    pub fn leaders(self) -> impl Iterator<Item = Channel> + Clone {
        Channel::first(self.channels).filter(move |it| self.group(*it) == *it)
    }

    /// Whether two channels fly the same laws.
    pub fn are_alike(&self, one: Channel, other: Channel) -> bool {
        self.group(one) == self.group(other)
    }
}

/// Limits of a flight; beyond one of them, another group takes over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimplexLimits {
    /// Angle between the measured body z axis and the vertical [rad].
    pub tilt_max_rad: f64,
    /// Magnitude of the measured body rate [rad/s].
    pub rate_max_rad_s: f64,
    /// Distance of the measured position from the reference [m].
    pub error_max_m: f64,
    /// Change of a rotor's command from one tick to the next [rad/s].
    pub command_step_max_rad_s: f64,
}

/// The values of a tick that [`SimplexLimits`] limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Excursion {
    pub tilt_rad: f64,
    pub rate_rad_s: f64,
    pub error_m: f64,
}

impl SimplexLimits {
    /// The limit that is exceeded. A number that is not finite exceeds its limit.
    fn exceeded(&self, at: &Excursion, command_step_rad_s: f64) -> Option<SwitchoverReason> {
        [
            (at.tilt_rad, self.tilt_max_rad, SwitchoverReason::Tilt),
            (at.rate_rad_s, self.rate_max_rad_s, SwitchoverReason::Rate),
            (
                at.error_m,
                self.error_max_m,
                SwitchoverReason::PositionError,
            ),
            (
                command_step_rad_s,
                self.command_step_max_rad_s,
                SwitchoverReason::CommandStep,
            ),
        ]
        .into_iter()
        .find(|(value, limit, _)| !value.is_finite() || value > limit)
        .map(|(.., reason)| reason)
    }
}

/// Chooses the group that flies, and its command of each tick.
#[derive(Clone, Copy, Debug)]
pub struct GroupSelection {
    pub arrangement: Arrangement,
    active: Channel,
    /// The first tick of the active group, and the group before.
    since: u64,
    before: Channel,
    flown_rad_s: Option<[f64; ROTORS]>,
}

impl GroupSelection {
    pub const fn new(arrangement: Arrangement) -> Self {
        Self {
            arrangement,
            active: Channel::A,
            since: 0,
            before: Channel::A,
            flown_rad_s: None,
        }
    }

    /// The group that flies a tick, as of the last decision.
    pub const fn group_at(&self, tick: u64) -> Channel {
        if tick < self.since {
            self.before
        } else {
            self.active
        }
    }

    /// The selection among the commands of a group.
    pub fn of_group(&self, group: Channel, candidates: &[Candidate]) -> Option<Selection> {
        let is_own = |it: &&Candidate| self.arrangement.group(it.channel) == group;
        let own: heapless::Vec<Candidate, MOST_CHANNELS> =
            candidates.iter().filter(is_own).copied().collect();
        select(&own)
    }

    /// Decides which group flies from a tick on, whose commands are the candidates. Returns the switchover, if there is one.
    ///
    /// A group takes over only with a usable command: the requested one, else beyond the limits one after the active one; if
    /// the active one has no usable command, it may be any.
    pub fn decide(
        &mut self,
        tick: u64,
        candidates: &[Candidate],
        requested: Option<Channel>,
        excursion: &Excursion,
    ) -> Option<Switchover> {
        let usable = |group| {
            self.of_group(group, candidates)
                .filter(|it| it.chosen.is_usable())
        };
        let step = |selection: &Selection| self.command_step_rad_s(selection);
        let requested = requested.map(|it| self.arrangement.group(it));
        let ready = requested.filter(|it| *it != self.active && usable(*it).is_some());
        let by_limits = || {
            let limits = self.arrangement.simplex?;
            let reason = match usable(self.active) {
                None => SwitchoverReason::Silent,
                Some(own) => limits.exceeded(excursion, step(&own))?,
            };
            let leaders = self.arrangement.leaders();
            let later = leaders.clone().filter(|it| *it > self.active);
            let earlier =
                leaders.filter(|it| *it < self.active && reason == SwitchoverReason::Silent);
            let mut others = later.chain(earlier);
            Some((others.find(|it| usable(*it).is_some())?, reason))
        };
        let by_request = ready.map(|it| (it, SwitchoverReason::Requested));
        let takes_over = by_request.or_else(by_limits);
        let switchover = takes_over.map(|(group, reason)| Switchover {
            tick,
            from: self.active as u64,
            to: group as u64,
            reason: reason as u64,
            command_step_rad_s: usable(group).as_ref().map_or(0.0, step),
        });
        if let Some((group, _)) = takes_over {
            (self.before, self.active, self.since) = (self.active, group, tick);
        }
        switchover
    }

    /// Takes the command that is flown.
    pub const fn fly(&mut self, selection: &Selection) {
        self.flown_rad_s = Some(selection.chosen.command.speed_rad_s);
    }

    fn command_step_rad_s(&self, selection: &Selection) -> f64 {
        let command = selection.chosen.command.speed_rad_s;
        self.flown_rad_s
            .map_or(0.0, |flown| largest_difference(&flown, &command))
    }

    /// Whether a channel's group has a usable command among these.
    pub fn is_ready(&self, channel: Channel, candidates: &[Candidate]) -> bool {
        let group = self.arrangement.group(channel);
        self.arrangement.leaders().count() > 1
            && self
                .of_group(group, candidates)
                .is_some_and(|it| it.chosen.is_usable())
    }
}

/// The largest difference between the commands of a rotor [rad/s].
pub(crate) fn largest_difference(one: &[f64; ROTORS], other: &[f64; ROTORS]) -> f64 {
    let pairs = one.iter().zip(other);
    pairs
        .map(|(one, other)| (one - other).abs())
        .fold(0.0, f64::max)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn candidate(
        channel: Channel,
        is_on_time: bool,
        is_fresh: bool,
        thrust_n: f64,
    ) -> Candidate {
        let command = RotorSpeeds {
            thrust_n,
            ..RotorSpeeds::default()
        };
        Candidate {
            channel,
            tick: 7,
            effective_tick: if is_on_time { 8 } else { 9 },
            is_fresh,
            history: UNDISTURBED,
            seq: 0,
            command,
        }
    }

    #[test]
    fn a_fresh_command_on_time_wins_and_of_three_the_majority() {
        // Channel and thrust of each command, and what is wrong with it; then what is selected.
        for case in [
            " -> None",
            "A1 B1 -> A",
            "B1 -> B",
            "A2:stale B1 -> B",
            "A1:late B1 -> B",
            "A2:stale B1:late -> A",
            // Two that differ: either may be wrong.
            "A1 B2 -> A differs",
            "A2 B1 C1 -> B differs, outvoted A",
            "A1 B1 C2 -> A differs, outvoted C",
            "A1 B2 C3 -> A differs",
            // A zero of the other sign is another bit.
            "A0 B-0 -> A differs",
            // Other states or inputs: an undisturbed command is flown, and nothing is compared.
            "A2:disturbed B1 -> B",
            "A2:disturbed B1 C1 -> B",
            "A1:disturbed B1:disturbed C2:disturbed -> A differs, outvoted C",
        ] {
            let (offered, expected) = case.split_once(" -> ").unwrap();
            let offered = offered.split_whitespace().map(|command| {
                let (channel, thrust) = command.split_at(1);
                let (thrust_n, flaw) = thrust.split_once(':').unwrap_or((thrust, ""));
                let channel = Channel::ALL
                    .into_iter()
                    .find(|it| format!("{it:?}") == channel);
                let (is_on_time, is_fresh) = (flaw != "late", flaw != "stale");
                let thrust_n = thrust_n.parse().unwrap();
                let it = candidate(channel.unwrap(), is_on_time, is_fresh, thrust_n);
                let history = if flaw == "disturbed" { 7 } else { it.history };
                Candidate { history, ..it }
            });
            let found = select(&offered.collect::<Vec<_>>()).map_or("None".to_owned(), |it| {
                let differs = if it.differs { " differs" } else { "" };
                let outvoted = it.outvoted.map(|channel| format!(", outvoted {channel:?}"));
                format!(
                    "{:?}{differs}{}",
                    it.chosen.channel,
                    outvoted.unwrap_or_default()
                )
            });
            assert_eq!(found, expected, "{case}");
        }
    }

    /// Two channels with laws of their own.
    fn apart(limits: Option<SimplexLimits>) -> GroupSelection {
        GroupSelection::new(Arrangement {
            groups: [Channel::A, Channel::B, Channel::C],
            simplex: limits,
            ..Arrangement::alike(2)
        })
    }

    #[test]
    fn another_group_flies_beyond_the_limits_or_on_request_and_hands_back_on_request_alone() {
        use Channel::{A, B};
        use SwitchoverReason::{CommandStep, PositionError, Silent, Tilt};
        let limits = SimplexLimits {
            tilt_max_rad: 0.5,
            rate_max_rad_s: 5.0,
            error_max_m: 0.5,
            command_step_max_rad_s: 50.0,
        };
        let command = |channel, is_fresh, speed: f64| {
            let mut it = candidate(channel, true, is_fresh, 1.0);
            it.command.speed_rad_s = [speed; ROTORS];
            it
        };
        let both = |speed_a| [command(A, true, speed_a), command(B, true, 300.0)];
        let excursion = |tilt_rad, error_m| Excursion {
            tilt_rad,
            error_m,
            ..Excursion::default()
        };
        let inside = excursion(0.1, 0.1);
        let tilted = excursion(0.6, 0.1);
        let far = excursion(0.1, 0.6);
        let nowhere = excursion(f64::NAN, 0.0);
        let only_a = [command(A, true, 300.0), command(B, false, 300.0)];
        for (commands, excursion, reason) in [
            (&both(300.0)[..], inside, None),
            (&both(300.0)[..], tilted, Some(Tilt)),
            (&both(300.0)[..], far, Some(PositionError)),
            (&both(300.0)[..], nowhere, Some(Tilt)),
            (&both(400.0)[..], inside, Some(CommandStep)),
            (&both(300.0)[1..], inside, Some(Silent)),
            // No other group has a usable command.
            (&only_a[..], tilted, None),
        ] {
            let mut guarded = apart(Some(limits));
            assert_eq!(guarded.decide(1, &both(310.0), None, &inside), None);
            guarded.fly(&select(&both(310.0)[..1]).unwrap());
            let found = guarded.decide(2, commands, None, &excursion);
            assert_eq!(found.map(|it| it.reason), reason.map(|it| it as u64));
            assert_eq!(guarded.group_at(2), if reason.is_some() { B } else { A });
            assert_eq!(guarded.group_at(1), A);
            assert_eq!(
                guarded.decide(3, &both(300.0), None, &inside),
                None,
                "no way back"
            );
            let mut shadow = apart(None);
            assert_eq!(shadow.decide(2, commands, None, &excursion), None);
        }
        let mut guarded = apart(Some(limits));
        let to_b = guarded.decide(1, &both(320.0), Some(B), &inside).unwrap();
        assert_eq!((to_b.tick, to_b.from, to_b.to, to_b.reason), (1, 0, 1, 0));
        guarded.fly(&select(&both(320.0)[1..]).unwrap());
        let to_a = guarded.decide(2, &both(320.0), Some(A), &tilted).unwrap();
        assert_eq!((to_a.to, to_a.command_step_rad_s), (0, 20.0));
        // A request that waits for its group keeps no other one from taking over.
        let mut three = GroupSelection::new(Arrangement {
            groups: Channel::ALL,
            simplex: Some(limits),
            ..Arrangement::alike(3)
        });
        let c = [command(Channel::C, true, 300.0)];
        let to_c = three.decide(1, &c, Some(B), &inside).unwrap();
        assert_eq!((to_c.to, to_c.reason), (2, Silent as u64));
        assert!(guarded.is_ready(B, &both(1.0)) && !guarded.is_ready(B, &both(1.0)[..1]));
        let alike = GroupSelection::new(Arrangement::alike(2));
        assert!(!alike.is_ready(B, &both(1.0)), "it would change nothing");
    }
}
