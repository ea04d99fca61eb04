//! The plant's process: absolute timer, commands in, states out, parameter swaps.
//!
//! It owns the role's tick; `requests` answers requests for parameter changes and faults on a thread of its own.
//! [`crate::plant`] owns what happens to the airframe in a tick.

mod injection;
mod requests;

use std::sync::{Arc, mpsc};
use std::thread;

use faults::FaultRefusal;
use faults::live::{LiveFault, LoopFaults};
use heapless::spsc::{Consumer, Producer, Queue};
use ipc::clock::{Horizon as _, now_ns, sleep_through, sleep_until};
use ipc::error::Error;
use ipc::{Blackboard, DEEP, Receiver, Sender, WakeEvent, Wakes, Wire};
use messages::blackboards::{ActiveParameters, EndReason, IN_FORCE, LOCKSTEP, Run, RunPhase};
use messages::channels::{REDUNDANCY, Redundancy};
use messages::content::{
    DECISIONS, Decision, Decisions, FlightTarget, Reference, RotorSpeeds, Stamped, State,
    SwapRecord, TakenCommand,
};
use messages::flight_plan::{FlightPlan, LOCKSTEP_LOOK_UP_NS, LOCKSTEP_PATIENCE_NS};
use messages::grid::{Grid, Pace};
use messages::header::{Header, Stamps};
use messages::inspection::Expected;
use messages::math::atan2;
use messages::rejections::Rejections;
use messages::role::{Channel, Role};
use nalgebra::Vector3;
use process::lead::ActiveLead;
use process::rt::UsageMeter;
use process::session::{Opened, RoleSession, log_landing};
use process::wakes::wakes;
use redundancy::{Arrangement, ChannelSelection, Excursion, SimplexLimits};

use crate::command_hold::{pending_commands, waiting_ticks};
use crate::envelope_violation::EnvelopeViolation;
use crate::guidance::PATIENCE_S;
use crate::plant::Plant;
use crate::settings::PlantSettings;
use crate::swap::Swap;

use injection::Injection;
use requests::{Action, Event, INBOX, OUTBOX, Request};

/// In lockstep, how far the recorder may fall behind: half of what its ports keep.
const RECORDER_LAG_TICKS: u64 = DEEP as u64 / 2;
/// Share of a tick, in percent, for which a plant that is above channel a leaves the processor to it.
const CHAIN_PERCENT: u64 = 20;
/// In lockstep, how often the plant looks while it waits for the recorder, which sends no wake-up event [ns].
const RECORDER_LOOK_UP_NS: u64 = 1_000_000;

/// Where the vehicle is to be at a tick with this state.
pub type Route = Arc<dyn Fn(u64, &State) -> Reference + Send + Sync>;

/// Runs the plant until its last tick, a signal, or the end of what the model covers. With simplex limits, a channel with other
/// laws takes over beyond it.
pub fn run(
    mut session: RoleSession,
    settings: &PlantSettings,
    plan: FlightPlan,
    faults: &[Swap],
    planned: &LoopFaults,
    simplex: Option<(SimplexLimits, Route)>,
) -> Result<(), Error> {
    let mut inbox = Queue::<Request, INBOX>::new();
    let mut outbox = Queue::<Event, OUTBOX>::new();
    let (requests_in, requests_out) = inbox.split();
    let (events_in, events_out) = outbox.split();
    let instance = session.wire().instance().clone();
    // Before real time is engaged: a thread inherits the priority and the processor of the one that starts it.
    thread::scope(|scope| {
        let (open, opened) = mpsc::channel();
        let (ready_sender, ready) = mpsc::channel();
        let server = scope.spawn(move || {
            let follows = settings.follows_targets;
            requests::serve(
                &instance,
                &ready_sender,
                &opened,
                requests_in,
                events_out,
                follows,
            )
        });
        // A server that cannot open ends, and its error is the result of `join` below.
        let flown = if ready.recv().is_ok() {
            let lockstep = plan.wall_period_ns == LOCKSTEP;
            let wakes = wakes(session.wire(), Role::Plant.into(), session.rt(), lockstep)?;
            let mut plant = PlantProcess::new(
                &session,
                wakes,
                settings,
                faults,
                simplex,
                requests_out,
                events_in,
            )?;
            plant.plan(planned);
            plant.serve(&mut session, plan, open)
        } else {
            Ok(())
        };
        let panicked = |_| Err(Error::failed("the request server panicked"));
        let served = server.join().unwrap_or_else(panicked);
        flown.and(served)
    })
}

struct PlantProcess<'a> {
    plant: Plant,
    states: Sender<State>,
    decisions: Sender<Decisions>,
    swaps: Sender<SwapRecord>,
    /// In the order of the channels.
    commands: Vec<Receiver<RotorSpeeds>>,
    channels: usize,
    /// Messages that each of these ports keeps.
    pending_commands: usize,
    selection: Box<ChannelSelection>,
    /// Commands that were read and decided on since the last state.
    decided: Vec<TakenCommand>,
    newest_taken: Option<RotorSpeeds>,
    /// Of a flight with several channels.
    redundancy: Option<Blackboard<Redundancy>>,
    route: Option<Route>,
    /// That of the last state.
    excursion: Excursion,
    /// The first tick that was not searched for a request to switch.
    next_switch: u64,
    event: WakeEvent,
    in_force: Blackboard<ActiveParameters>,
    requests: Consumer<'a, Request>,
    events: Producer<'a, Event>,
    injection: Injection,
    /// Ticks for which a target is followed without another one, and the tick at which that is over.
    patience_ticks: u64,
    hold_at: Option<u64>,
    /// Whether channel a is below the plant on its processor, and works its tick while the plant sleeps.
    is_above: bool,
    lead: ActiveLead,
    previous_busy_ns: u64,
    ticks_run: u64,
}

impl<'a> PlantProcess<'a> {
    /// The plant at tick 0, with its ports made and its faults scheduled.
    fn new(
        session: &RoleSession,
        wakes: Wakes,
        settings: &PlantSettings,
        faults: &[Swap],
        simplex: Option<(SimplexLimits, Route)>,
        requests: Consumer<'a, Request>,
        events: Producer<'a, Event>,
    ) -> Result<Self, Error> {
        let (wire, channels) = (session.wire(), session.rt().channels);
        let (simplex, route) = simplex.unzip();
        let arrangement = Arrangement {
            channels,
            groups: session.rt().groups,
            simplex,
        };
        let rows = waiting_ticks(settings.period_s);
        let redundancy = || wire.blackboard(REDUNDANCY);
        let injection = Injection::none(
            wire,
            settings.seed,
            (settings.period_s * 1e9).round() as u64,
        )?;
        let mut plant = Plant::new(settings);
        plant.take_faults(injection.messages());
        for fault in faults {
            plant
                .schedule(fault.clone())
                .map_err(|e| Error::usage(format!("cannot schedule a fault: {e}")))?;
        }
        let in_force = wire.blackboard(IN_FORCE)?;
        in_force.put(ActiveParameters {
            tick: 0,
            parameter_epoch: 0,
            value: *plant.airframe().values(),
        });
        Ok(Self {
            plant,
            injection,
            patience_ticks: (PATIENCE_S / settings.period_s).round() as u64,
            hold_at: None,
            is_above: session.rt().channel_cpus > 1,
            states: wire.sender(wakes)?,
            decisions: wire.sender(Wakes::default())?,
            swaps: wire.sender(Wakes::default())?,
            // The ports of the loop that keep more than the newest: see `take_command`.
            commands: Vec::new(),
            channels,
            pending_commands: pending_commands(settings.period_s),
            selection: Box::new(ChannelSelection::new(arrangement, rows)),
            // One for each command that is taken, and for each that a full port holds beyond them.
            decided: Vec::with_capacity(rows * (1 + channels)),
            newest_taken: None,
            redundancy: (channels > 1).then(redundancy).transpose()?,
            route: route.filter(|_| channels > 1),
            excursion: Excursion::default(),
            next_switch: 0,
            event: wire.wake_event(Role::Plant)?,
            in_force,
            requests,
            events,
            lead: ActiveLead::none(),
            previous_busy_ns: 0,
            ticks_run: 0,
        })
    }

    /// Takes the planned faults of messages and stages.
    fn plan(&mut self, faults: &LoopFaults) {
        self.injection.plan(faults);
        self.plant.change_faults(&faults.messages, None);
    }

    /// Connects the ports to those of the other roles, and makes those for commands: the recorder has its own by now.
    fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error> {
        if self.commands.is_empty() {
            let receiver = |channel| wire.receiver_of(channel, self.pending_commands);
            self.commands = Channel::first(self.channels)
                .map(receiver)
                .collect::<Result<_, _>>()?;
        }
        self.states.arm(expected, epoch)?;
        self.decisions.arm(expected, epoch)?;
        self.swaps.arm(expected, epoch)?;
        self.commands
            .iter_mut()
            .try_for_each(|commands| commands.arm(expected))
    }

    fn serve(
        &mut self,
        session: &mut RoleSession,
        plan: FlightPlan,
        open: mpsc::Sender<()>,
    ) -> Result<(), Error> {
        self.injection.slowdown = plan.wall_period_ns / plan.sample_time_ns.max(1);
        self.injection.last_tick = plan.last_tick;
        let mut opened = session.open_run(plan, |wire, expected, epoch| {
            self.arm(wire, expected, epoch)
        })?;
        // A server that has ended on an error does not hear it; its error comes with its end.
        let _ = open.send(());
        let lead = session.choose_lead(&mut opened, || self.rehearse(0));
        let meter = UsageMeter::start();
        let flown = lead.and_then(|lead| {
            self.lead = lead;
            self.fly(session, &mut opened, plan.last_tick)
        });
        let ending = *flown.as_ref().unwrap_or(&EndReason::Failed);
        opened.run.ending = ending as u64;
        opened.run.phase = RunPhase::Closed as u64;
        opened.blackboard.put(opened.run);
        session.land(&meter);
        if flown.is_ok() {
            log_landing(Role::Plant, &opened.run);
        }
        flown.map(|_| ())
    }

    fn fly(
        &mut self,
        session: &mut RoleSession,
        opened: &mut Opened,
        last_tick: u64,
    ) -> Result<EndReason, Error> {
        let pace = opened.pace;
        if pace == Pace::Lockstep {
            sleep_through(opened.run.t0_ns);
        }
        let mut next_tick = 0;
        loop {
            let (tick, waking) = match pace {
                Pace::Realtime(grid) => {
                    let waking = self.wait_for_tick(next_tick, last_tick, grid)?;
                    // However late the plant wakes, the last tick is flown, and those before it.
                    let latest = last_tick.max(next_tick);
                    let tick = grid.tick_at(waking.wake_ns).clamp(next_tick, latest);
                    (tick, waking)
                }
                Pace::Lockstep => match self.wait_for_command(next_tick, session, opened)? {
                    Some(wake_ns) => (next_tick, Waking::at(wake_ns)),
                    None => return Ok(opened.requested_end().unwrap_or(EndReason::Interrupted)),
                },
            };
            if tick > last_tick {
                self.take_command(tick, pace)?;
                self.decide(tick);
                self.publish_decisions(tick)?;
                self.show_redundancy();
                let state = self.plant.end(last_tick);
                self.report(&state, &mut opened.run);
                return Ok(EndReason::Completed);
            }
            let (state, envelope) = self.tick(tick, waking, pace)?;
            opened.run.tick = tick;
            opened.run.ticks_run = self.ticks_run;
            self.report(&state, &mut opened.run);
            opened.blackboard.put(opened.run);
            session.status.ticks_run = self.ticks_run;
            session.status.ticks_skipped = state.ticks_skipped;
            let rejections = self.commands.iter().map(Receiver::rejections);
            session.status.rejections = rejections.fold(self.plant.rejections(), Rejections::and);
            session.publish_status();
            if let Err(violation) = envelope {
                return Ok(match violation {
                    EnvelopeViolation::NotFinite { .. } => EndReason::NonFinite,
                    EnvelopeViolation::Crash(_) => EndReason::Crash,
                    EnvelopeViolation::Tilt { .. } => EndReason::Attitude,
                });
            }
            if session.stop_requested() {
                return Ok(EndReason::Interrupted);
            }
            if let Some(ending) = opened.requested_end() {
                return Ok(ending);
            }
            next_tick = tick + 1;
            self.previous_busy_ns = now_ns() - waking.wake_ns;
        }
    }

    fn report(&self, state: &State, run: &mut Run) {
        run.ticks_skipped = state.ticks_skipped;
        run.deadlines_missed = state.deadlines_missed;
        run.deadline_miss_run = state.deadline_miss_run;
        run.parameter_epoch = state.parameter_epoch;
    }

    /// One tick: take the command and the swaps, publish the state, integrate to the next tick.
    fn tick(
        &mut self,
        tick: u64,
        waking: Waking,
        pace: Pace,
    ) -> Result<(State, Result<(), EnvelopeViolation>), Error> {
        self.take_command(tick, pace)?;
        self.decide(tick);
        while let Some(request) = self.requests.dequeue() {
            self.accept(request, tick);
        }
        if self.hold_at.take_if(|at| *at <= tick).is_some() {
            self.aim(FlightTarget::default(), false, tick);
        }
        let mut state = self.plant.begin(tick);
        let envelope = self.plant.envelope();
        self.publish_changes()?;
        state.decision = self.decision(&state.decision);
        if state.decision.count > 1 {
            self.publish_decisions(tick)?;
        }
        self.injection.be_late(tick);
        if !matches!(envelope, Err(EnvelopeViolation::NotFinite { .. })) {
            self.states
                .send(tick, &self.history(waking, &state), state)?;
            self.ticks_run += 1;
        }
        self.decided.clear();
        self.show_redundancy();
        self.excursion = self.excursion_of(tick, &state);
        if let (true, Pace::Realtime(grid)) = (self.is_above, pace) {
            sleep_until(grid.begin_of(tick) + grid.period_ns * CHAIN_PERCENT / 100);
        }
        self.plant.finish();
        Ok((state, envelope))
    }

    /// Has all stages do a warm-up run of their next tick, and returns when they have, or at once where they run elsewhere.
    ///
    /// Nothing of the flight changes: it looks at the plant, and prepares a message that is not sent.
    fn rehearse(&mut self, tick: u64) -> Result<(), Error> {
        let state = self.plant.state();
        let waking = Waking::at(now_ns());
        self.states
            .rehearse(tick, &self.history(waking, &state), state)
    }

    fn history(&self, waking: Waking, state: &State) -> Header {
        let mut history = Header {
            sample_ns: waking.wake_ns,
            lead_ns: waking.lead_ns,
            timer_late_ns: waking.timer_late_ns,
            parameter_epoch: state.parameter_epoch,
            previous_busy_ns: self.previous_busy_ns,
            ..Header::new()
        };
        history.stamps[Role::Plant as usize] = Stamps {
            receive_ns: waking.wake_ns,
            send_ns: 0,
        };
        history
    }

    /// Sleeps until the lead before a tick, does a warm-up run if there is time, and reads the clock until the tick begins.
    fn wait_for_tick(&mut self, tick: u64, last_tick: u64, grid: Grid) -> Result<Waking, Error> {
        let (begin_ns, lead_ns) = (grid.begin_of(tick), self.lead.lead_ns());
        // Where the tick before took longer than until then, no timer is set, and none is late.
        let timer_ns = begin_ns.saturating_sub(lead_ns).max(now_ns());
        let mut now = sleep_through(timer_ns);
        let timer_late_ns = now - timer_ns;
        let mut rehearsal_ns = 0;
        if tick <= last_tick && self.lead.allows_rehearsal(begin_ns.saturating_sub(now)) {
            // Commands that are there are taken in any case: now, and once more when the tick begins.
            self.take_command(tick, Pace::Realtime(grid))?;
            self.rehearse(tick)?;
            rehearsal_ns = now_ns() - now;
        }
        self.lead.follow(timer_late_ns, rehearsal_ns);
        while now < begin_ns {
            now = now_ns();
        }
        Ok(Waking {
            wake_ns: now,
            lead_ns,
            timer_late_ns,
        })
    }

    /// Reads every command that has come since the last look. It waits until its tick is decided on.
    ///
    /// All of them are read, not just the newest. If the plant wakes late, the command of the tick before lies beneath
    /// a newer one, and the plant's lateness must not count as the other stages'.
    fn take_command(&mut self, tick: u64, pace: Pace) -> Result<(), Error> {
        let Self {
            plant,
            selection,
            decided,
            ..
        } = self;
        // Other stages may be ahead of a plant that was stopped after it read the clock.
        let latest_tick = || match pace {
            Pace::Realtime(_) => pace.latest_tick().max(tick),
            Pace::Lockstep => tick,
        };
        for (channel, commands) in Channel::ALL.into_iter().zip(&mut self.commands) {
            commands.drain(latest_tick, |message| {
                let sent_ns = message.envelope.stamps_of(Role::Mixer).send_ns;
                let acts_from = pace.effective_tick(message.envelope.tick, sent_ns);
                if let Some(refused) = selection.offer(channel, message, acts_from) {
                    plant.refuse();
                    decided.push(refused.refused());
                }
            })?;
        }
        Ok(())
    }

    fn show_redundancy(&self) {
        if let Some(blackboard) = &self.redundancy {
            blackboard.put(*self.selection.redundancy());
        }
    }

    /// Decides which commands of the ticks before are taken, and offers them to the plant.
    fn decide(&mut self, tick: u64) {
        let Some(newest) = tick.checked_sub(1) else {
            return;
        };
        if let Some((from, channel)) = self.injection.switch(self.next_switch..=newest) {
            self.selection.request(from, channel);
        }
        self.next_switch = tick;
        let (plant, decided) = (&mut self.plant, &mut self.decided);
        let arrangement = *self.selection.arrangement();
        self.selection.decide(tick, &self.excursion, |it| {
            let command = Stamped::new(it.tick, it.command);
            let group = arrangement.group(it.channel);
            decided.push(it.taken(plant.offer_of(group, &command, it.effective_tick)));
            self.newest_taken = Some(it.command);
        });
    }

    /// The record of the decisions since the last state.
    fn decision(&self, of_plant: &Decision) -> Decision {
        let command = match self.decided[..] {
            [command] => command,
            _ => TakenCommand::default(),
        };
        Decision {
            count: self.decided.len() as u64,
            command,
            ..*of_plant
        }
    }

    /// Publishes the decisions since the last state, before the state that they led to.
    #[cold]
    fn publish_decisions(&mut self, tick: u64) -> Result<(), Error> {
        let none: &[TakenCommand] = &[];
        let is_none = self.decided.is_empty();
        for part in self
            .decided
            .chunks(DECISIONS)
            .chain(is_none.then_some(none))
        {
            let mut decisions = Decisions {
                count: part.len() as u64,
                ..Decisions::default()
            };
            decisions.command[..part.len()].copy_from_slice(part);
            self.decisions.send(tick, &Header::new(), decisions)?;
        }
        Ok(())
    }

    /// How far the vehicle is from the simplex limits, as measured.
    fn excursion_of(&self, tick: u64, state: &State) -> Excursion {
        let Some(route) = &self.route else {
            return Excursion::default();
        };
        let measured = &state.measured;
        let [_, x, y, _] = measured.attitude_quaternion;
        let sin_half = (x * x + y * y).sqrt();
        let position_w_m = Vector3::from(measured.position_w_m);
        let error_w_m = position_w_m - Vector3::from(route(tick, state).position_w_m);
        Excursion {
            tilt_rad: 2.0 * atan2(sin_half, (1.0 - sin_half * sin_half).max(0.0).sqrt()),
            rate_rad_s: Vector3::from(measured.rate_b_rad_s).norm(),
            error_m: error_w_m.norm(),
        }
    }

    /// In lockstep: waits for the command of the tick before from every channel, and for the recorder to keep up.
    ///
    /// Returns when it came, or nothing if the run is to end.
    fn wait_for_command(
        &mut self,
        tick: u64,
        session: &RoleSession,
        opened: &Opened,
    ) -> Result<Option<u64>, Error> {
        let until_ns = now_ns() + LOCKSTEP_PATIENCE_NS;
        loop {
            self.take_command(tick, Pace::Lockstep)?;
            // After the port: a command is never taken before it was sent.
            let now = now_ns();
            let is_there = tick == 0
                || self.commands.iter().all(|commands| {
                    commands.has_any() && commands.newest().envelope.tick + 1 >= tick
                });
            let recorded = opened.recorded_tick();
            // Who wants the end has said so before the command could come: the flight ends with the tick before.
            if session.stop_requested() || opened.requested_end().is_some() {
                return Ok(None);
            }
            if is_there && tick < recorded + RECORDER_LAG_TICKS {
                return Ok(Some(now));
            }
            if now >= until_ns {
                let what = if is_there {
                    format!(
                        "the recorder has not got beyond tick {recorded} of {tick}: `ironbird record` hangs or has died"
                    )
                } else {
                    format!(
                        "no rotor command of tick {} in lockstep: a stage hangs or has died",
                        tick - 1
                    )
                };
                return Err(Error::failed(what));
            }
            self.event.wait_until(
                now + if is_there {
                    RECORDER_LOOK_UP_NS
                } else {
                    LOCKSTEP_LOOK_UP_NS
                },
            )?;
        }
    }

    /// Schedules a parameter change, or injects faults; reports a refusal, and the ticks of faults.
    fn accept(&mut self, request: Request, tick: u64) {
        let (id, first_tick) = (request.id, request.first_tick(tick));
        let event = match request.action {
            Action::Change(mut swap) => {
                (swap.tick, swap.request_id) = (first_tick, id);
                match self.plant.schedule(swap) {
                    Ok(_) => return,
                    Err(reason) => Event::Refused { id, tick, reason },
                }
            }
            Action::Inject { faults, .. } if let Some(which) = self.unready(&faults) => {
                let reason = FaultRefusal::NotReady;
                Event::FaultRefused { id, which, reason }
            }
            Action::Inject { for_ticks, faults } => {
                match self.injection.inject(&faults, first_tick, for_ticks, tick) {
                    Ok(span) => {
                        let faults = self.injection.messages();
                        self.plant.change_faults(faults, self.newest_taken);
                        Event::Injected { id, span }
                    }
                    Err((which, reason)) => Event::FaultRefused { id, which, reason },
                }
            }
            Action::Aim(order) => {
                self.aim(order.target, order.has_yaw == 1, tick);
                self.hold_at = (order.stays == 0).then_some(tick + self.patience_ticks);
                return;
            }
        };
        // The outbox holds more events than requests can be under way.
        let _ = self.events.enqueue(event);
    }

    /// Follows a target from a tick on; one that is repeated is the same one.
    fn aim(&mut self, target: FlightTarget, has_yaw: bool, tick: u64) {
        let Some(newest) = self.plant.target() else {
            return;
        };
        let target = FlightTarget {
            from_tick: newest.from_tick,
            yaw_rad: if has_yaw {
                target.yaw_rad
            } else {
                newest.yaw_rad
            },
            ..target
        };
        if target != *newest {
            let from_tick = tick;
            self.plant.aim(FlightTarget {
                from_tick,
                ..target
            });
        }
    }

    /// The first request to switch to a channel that the flight does not have, or that has no usable command.
    fn unready(&self, faults: &[LiveFault]) -> Option<usize> {
        let switches = faults.iter().map(|fault| fault.kind.switch());
        let mut is_unready =
            switches.map(|switch| switch.is_some_and(|channel| !self.selection.is_ready(channel)));
        is_unready.position(|is_unready| is_unready)
    }

    /// Publishes the parameter changes of the ticks up to the present one, before its state.
    fn publish_changes(&mut self) -> Result<(), Error> {
        let Some(tick) = self.plant.changed_tick() else {
            return Ok(());
        };
        let (parameter_epoch, value) = (
            self.plant.parameter_epoch(),
            *self.plant.airframe().values(),
        );
        self.in_force.put(ActiveParameters {
            tick,
            parameter_epoch,
            value,
        });
        for applied in self.plant.applied() {
            self.swaps
                .send(applied.tick, &Header::new(), applied.record())?;
            let _ = self.events.enqueue(Event::Applied(applied.clone()));
        }
        Ok(())
    }
}

/// How the plant woke for a tick.
#[derive(Clone, Copy)]
struct Waking {
    wake_ns: u64,
    /// How far ahead of the tick its timer was to be set [ns].
    lead_ns: u64,
    /// How late the kernel woke it, after the instant that its timer was set to [ns].
    timer_late_ns: u64,
}

impl Waking {
    /// Without a timer.
    const fn at(wake_ns: u64) -> Self {
        Self {
            wake_ns,
            lead_ns: 0,
            timer_late_ns: 0,
        }
    }
}
