//! The plant's process: absolute timer, commands in, states out, parameter swaps.
//!
//! It owns the role's tick and takes swaps from the parameter desk. [`crate::plant`] owns what happens to the airframe
//! in a tick.

use std::sync::mpsc;
use std::thread;

use heapless::spsc::{Consumer, Producer, Queue};
use ipc::clock::{Horizon as _, now_ns, sleep_until};
use ipc::error::Error;
use ipc::{Blackboard, DEEP, Receiver, Sender, WakeEvent, Wire};
use messages::blackboards::{ActiveParameters, EndReason, IN_FORCE, Run, RunPhase};
use messages::content::{RotorSpeeds, Stamped, State};
use messages::fault::live::{Acts, LoopFaults};
use messages::flight_plan::{FlightPlan, LOCKSTEP_LOOK_UP_NS, LOCKSTEP_PATIENCE_NS};
use messages::grid::{Grid, Pace};
use messages::header::{Header, Stamps};
use messages::role::Role;
use process::lead::ActiveLead;
use process::rt::UsageMeter;
use process::session::log_landing;
use process::session::{Opened, RoleSession};

use crate::command_hold::pending_commands;
use crate::envelope_violation::EnvelopeViolation;
use crate::injection::Injection;
use crate::parameter_server::{self, Event, INBOX, OUTBOX, Request, SwapRequest};
use crate::plant::Plant;
use crate::settings::PlantSettings;
use crate::swap::Swap;

/// In lockstep, how far the recorder may fall behind: half of what its ports keep.
const RECORDER_LAG_TICKS: u64 = DEEP as u64 / 2;
/// In lockstep, how often the plant looks up while it waits for the recorder, which rings nobody [ns].
const RECORDER_LOOK_UP_NS: u64 = 1_000_000;

/// Runs the plant until its last tick, a signal, or the end of what the model covers.
pub fn run(
    mut station: RoleSession,
    settings: &PlantSettings,
    plan: FlightPlan,
    faults: &[Swap],
    planned: (&LoopFaults, &Acts),
) -> Result<(), Error> {
    let mut inbox = Queue::<Request, INBOX>::new();
    let mut outbox = Queue::<Event, OUTBOX>::new();
    let (orders_in, orders_out) = inbox.split();
    let (events_in, events_out) = outbox.split();
    let instance = station.wire().instance().clone();
    // Before real time is engaged: a thread inherits the priority and the processor of the one that starts it.
    thread::scope(|scope| {
        let (open_desk, opened) = mpsc::channel();
        let (tell, told) = mpsc::channel();
        let desk = scope.spawn(move || {
            parameter_server::serve(&instance, &tell, &opened, orders_in, events_out)
        });
        // A desk that cannot open ends, and its error is the result of `join` below.
        let flown = if told.recv().is_ok() {
            let mut plant =
                PlantProcess::new(station.wire(), settings, faults, orders_out, events_in)?;
            plant.planned(planned);
            plant.serve(&mut station, plan, &open_desk)
        } else {
            Ok(())
        };
        drop(open_desk);
        let served = desk.join().unwrap_or(Err(Error::Panicked {
            thread: "the parameter desk",
        }));
        flown.and(served)
    })
}

#[allow(
    missing_debug_implementations,
    reason = "the middleware's handles have none"
)]
pub struct PlantProcess<'a> {
    plant: Plant,
    states: Sender<State>,
    commands: Receiver<RotorSpeeds>,
    doorbell: WakeEvent,
    in_force: Blackboard<ActiveParameters>,
    orders: Consumer<'a, Request>,
    events: Producer<'a, Event>,
    injection: Injection,
    lead: ActiveLead,
    previous_busy_ns: u64,
    ticks_run: u64,
}

impl<'a> PlantProcess<'a> {
    /// The plant at tick 0, with its ports made and its faults scheduled.
    pub fn new(
        wire: &Wire,
        settings: &PlantSettings,
        faults: &[Swap],
        orders: Consumer<'a, Request>,
        events: Producer<'a, Event>,
    ) -> Result<Self, Error> {
        let injection = Injection::none(
            wire,
            settings.seed,
            (settings.period_s * 1e9).round() as u64,
        )?;
        let mut plant = Plant::new(settings);
        plant.gate_by(injection.messages());
        for fault in faults {
            plant.schedule(fault.clone()).map_err(|e| Error::TooMuch {
                what: format!("cannot schedule a fault: {e}"),
            })?;
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
            states: wire.sender(Some(wire.notifier(Role::Outer)?))?,
            // The one port of the loop that keeps more than the newest: see `take_command`.
            commands: wire.receiver(pending_commands(settings.period_s))?,
            doorbell: wire.wake_event(Role::Plant)?,
            in_force,
            orders,
            events,
            lead: ActiveLead::none(),
            previous_busy_ns: 0,
            ticks_run: 0,
        })
    }

    /// Takes what is planned to go wrong with messages and stages.
    pub fn planned(&mut self, (faults, acts): (&LoopFaults, &Acts)) {
        self.injection.plan(faults, acts);
        self.plant.change_faults(&faults.messages, None);
    }

    /// Connects the ports to those of the other roles.
    pub fn arm(
        &mut self,
        expected: messages::inspection::Expected,
        epoch: u64,
    ) -> Result<(), Error> {
        self.states.arm(expected, epoch)?;
        self.commands.arm(expected)
    }

    fn serve(
        &mut self,
        station: &mut RoleSession,
        plan: FlightPlan,
        open_desk: &mpsc::Sender<(messages::inspection::Expected, u64)>,
    ) -> Result<(), Error> {
        self.injection.slowdown = plan.wall_period_ns / plan.sample_time_ns.max(1);
        self.injection.last_tick = plan.last_tick;
        let mut opened = station.open_run(plan, |expected, epoch| self.arm(expected, epoch))?;
        // A desk that has ended on an error takes no run number; its error comes with its end.
        let _ = open_desk.send((opened.expected, station.status.epoch));
        let lead = station.choose_lead(&mut opened, || self.rehearse(0));
        let meter = UsageMeter::start();
        let flown = lead.and_then(|lead| {
            self.lead = lead;
            self.fly(station, &mut opened, plan.last_tick)
        });
        let ending = *flown.as_ref().unwrap_or(&EndReason::Failed);
        opened.run.ending = ending as u64;
        opened.run.phase = RunPhase::Closed as u64;
        opened.board.put(opened.run);
        station.land(&meter);
        if flown.is_ok() {
            log_landing(Role::Plant, &opened.run);
        }
        flown.map(|_| ())
    }

    fn fly(
        &mut self,
        station: &mut RoleSession,
        opened: &mut Opened,
        last_tick: u64,
    ) -> Result<EndReason, Error> {
        let pace = opened.pace;
        if pace == Pace::Lockstep {
            wait_until(opened.run.t0_ns);
        }
        let mut next_tick = 0;
        loop {
            let (tick, waking) = match pace {
                Pace::Realtime(grid) => {
                    let waking = self.wait_for_tick(next_tick, last_tick, grid)?;
                    (grid.tick_at(waking.wake_ns).max(next_tick), waking)
                }
                Pace::Lockstep => match self.wait_for_command(next_tick, station, opened)? {
                    Some(wake_ns) => (next_tick, Waking::at(wake_ns)),
                    None => return Ok(opened.wanted_end().unwrap_or(EndReason::Interrupted)),
                },
            };
            if tick > last_tick {
                self.take_command(last_tick + 1, pace)?;
                let state = self.plant.end(last_tick);
                // Those of the last ticks, where they were skipped. The desk answers that all others came too late.
                self.hand_over_applied();
                self.report(&state, &mut opened.run);
                return Ok(EndReason::Completed);
            }
            let worked = self.tick(tick, waking, pace)?;
            opened.run.tick = tick;
            opened.run.ticks_run = self.ticks_run;
            self.report(&worked.state, &mut opened.run);
            opened.board.put(opened.run);
            station.status.ticks_run = self.ticks_run;
            station.status.ticks_skipped = worked.state.ticks_skipped;
            station.status.rejections = self.commands.rejections().and(&self.plant.rejections());
            station.publish_status();
            if let Err(departure) = worked.envelope {
                return Ok(match departure {
                    EnvelopeViolation::NotFinite { .. } => EndReason::NonFinite,
                    EnvelopeViolation::Crash(_) => EndReason::Crash,
                    EnvelopeViolation::Tilt { .. } => EndReason::Attitude,
                });
            }
            if station.stop_requested() {
                return Ok(EndReason::Interrupted);
            }
            if let Some(ending) = opened.wanted_end() {
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
    pub fn tick(&mut self, tick: u64, waking: Waking, pace: Pace) -> Result<PlantTick, Error> {
        self.take_command(tick, pace)?;
        while let Some(order) = self.orders.dequeue() {
            match order {
                Request::Swap(order) => self.schedule(order, tick),
                Request::Faults(order) => {
                    let newest = self
                        .commands
                        .has_any()
                        .then(|| self.commands.newest().content);
                    // The outbox holds more events than orders can be under way.
                    let _ = self.events.enqueue(self.injection.strike(
                        &order,
                        tick,
                        &mut self.plant,
                        newest,
                    ));
                }
            }
        }
        let state = self.plant.begin(tick);
        let envelope = self.plant.envelope();
        self.injection.be_late(tick);
        if !matches!(envelope, Err(EnvelopeViolation::NotFinite { .. })) {
            self.states
                .send(tick, &self.history(waking, &state), state)?;
            self.ticks_run += 1;
        }
        self.hand_over_applied();
        self.plant.finish();
        Ok(PlantTick { state, envelope })
    }

    /// Has all stages rehearse their next tick, and returns when they have, or at once where they run elsewhere.
    ///
    /// Nothing of the flight changes: it looks at the plant, and prepares a message that is not sent.
    pub fn rehearse(&mut self, tick: u64) -> Result<(), Error> {
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

    /// Sleeps until the lead before a tick, rehearses if there is time, and reads the clock until the tick begins.
    fn wait_for_tick(&mut self, tick: u64, last_tick: u64, grid: Grid) -> Result<Waking, Error> {
        let (begin_ns, lead_ns) = (grid.begin_of(tick), self.lead.lead_ns());
        // Where the tick before took longer than until then, no timer is set, and none is late.
        let asked_ns = begin_ns.saturating_sub(lead_ns).max(now_ns());
        let mut now = wait_until(asked_ns);
        let timer_late_ns = now - asked_ns;
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

    /// Offers every command that has come since the last look.
    ///
    /// It offers all of them, not just the newest. If the plant wakes late, the command of the tick before lies beneath
    /// a newer one, and the plant's lateness must not count as the other stages'.
    fn take_command(&mut self, tick: u64, pace: Pace) -> Result<(), Error> {
        let plant = &mut self.plant;
        // The others may be further on than a plant that was stopped after it had read the clock.
        let latest_tick = || match pace {
            Pace::Realtime(_) => pace.latest_tick().max(tick),
            Pace::Lockstep => tick,
        };
        self.commands.drain(latest_tick, |message| {
            let made_for = message.envelope.tick;
            let effective_tick =
                pace.effective_tick(made_for, message.envelope.stamps_of(Role::Mixer).send_ns);
            plant.offer(&Stamped::new(made_for, message.content), effective_tick);
        })
    }

    /// In lockstep: waits for the command of the tick before, and for the recorder to keep up.
    ///
    /// Returns when it came, or nothing if the run is to end.
    fn wait_for_command(
        &mut self,
        tick: u64,
        station: &RoleSession,
        opened: &Opened,
    ) -> Result<Option<u64>, Error> {
        let until_ns = now_ns() + LOCKSTEP_PATIENCE_NS;
        loop {
            self.take_command(tick, Pace::Lockstep)?;
            // After the port: a command is never taken before it was sent.
            let now = now_ns();
            let is_there = tick == 0
                || (self.commands.has_any() && self.commands.newest().envelope.tick + 1 >= tick);
            let recorded = opened.recorded_tick();
            // Who wants the end has said so before the command could come: the flight ends with the tick before.
            if station.stop_requested() || opened.wanted_end().is_some() {
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
                return Err(Error::Absent { what });
            }
            self.doorbell.wait_until(
                now + if is_there {
                    RECORDER_LOOK_UP_NS
                } else {
                    LOCKSTEP_LOOK_UP_NS
                },
            )?;
        }
    }

    fn schedule(&mut self, order: SwapRequest, tick: u64) {
        let wanted = order
            .tick
            .unwrap_or_else(|| tick.saturating_add(order.in_ticks));
        let swap = Swap {
            tick: wanted,
            ..order.swap
        };
        let ticket = swap.ticket;
        if let Err(reason) = self.plant.schedule(swap) {
            // The outbox holds more events than orders can be under way.
            let _ = self.events.enqueue(Event::Refused {
                ticket,
                tick,
                reason,
            });
        }
    }

    fn hand_over_applied(&mut self) {
        let Some(tick) = self.plant.changed_tick() else {
            return;
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
            let _ = self.events.enqueue(Event::Applied(applied.clone()));
        }
    }
}

/// How the plant woke for a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waking {
    pub wake_ns: u64,
    /// How far ahead of the tick its timer was to be set [ns].
    pub lead_ns: u64,
    /// How late the kernel woke it, after the instant that its timer was set to [ns].
    pub timer_late_ns: u64,
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

/// Sleeps until an instant, through signals; gives when it woke.
fn wait_until(instant_ns: u64) -> u64 {
    loop {
        sleep_until(instant_ns);
        let now = now_ns();
        if now >= instant_ns {
            return now;
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantTick {
    pub state: State,
    pub envelope: Result<(), EnvelopeViolation>,
}
