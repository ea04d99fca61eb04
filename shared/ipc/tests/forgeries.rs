//! Forged messages on real ports: rejected and counted, while good ones pass.
//!
//! The forger holds the topic's only publisher, so none of our sender's checks protect the receiver. Only the
//! inspection stands between the two. Rejections are counted by reason.

use ::ipc::sys::Sealed;
use ::ipc::{DEEP, Receiver, Wire};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{Node, ipc};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::inspection::{Expected, Reason};
use messages::parameters::PARAMETERS;
use messages::telemetry::Telemetry;
use messages::topic::Topic;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use crate::{EPOCH, EXPECTED, Site};

/// The publisher of a topic without a sender's manners.
struct Forger<C: Topic> {
    publisher: Publisher<ipc::Service, Sealed<Message<C>>, ()>,
    _service: PortFactory<ipc::Service, Sealed<Message<C>>, ()>,
    _node: Node<ipc::Service>,
}

impl<C: Topic> Forger<C> {
    /// On a topic that a receiver has made.
    fn on(site: &Site) -> Self {
        let node = crate::node(site);
        let name = format!("ironbird/test/{}", C::NAME);
        let service = node
            .service_builder(&name.as_str().try_into().unwrap())
            .publish_subscribe::<Sealed<Message<C>>>()
            .open()
            .unwrap();
        let publisher = service.publisher_builder().create().unwrap();
        Self {
            publisher,
            _service: service,
            _node: node,
        }
    }

    fn send(&self, message: Message<C>) {
        self.publisher.send_copy(Sealed::new(message)).unwrap();
    }
}

fn armed<C: Topic>(wire: &Wire) -> Receiver<C> {
    let mut receiver = wire.receiver(DEEP).unwrap();
    receiver.arm(EXPECTED).unwrap();
    receiver
}

/// A message that nothing is wrong with.
fn good<C: Topic>(tick: u64) -> Message<C> {
    let Expected { run_id, settings } = EXPECTED;
    Message {
        envelope: Header {
            run_id,
            settings,
            epoch: EPOCH,
            seq: tick,
            tick,
            ..Header::new()
        },
        content: C::default(),
    }
}

/// What makes a good message a forged one, and the reason for which it must be rejected.
type Forgery<C> = (Reason, fn(&mut Message<C>));

/// Sends good and forged messages in turn; every good one must pass, every forged one be counted with its reason.
fn assert_rejected<C: Topic + PartialEq>(forgeries: &[Forgery<C>]) {
    let site = Site::new();
    let wire = site.wire();
    let mut receiver = armed::<C>(&wire);
    let forger = Forger::<C>::on(&site);
    receiver.arm(EXPECTED).unwrap();
    let mut good_tick = 10;
    forger.send(good(good_tick));
    for (_, forge) in forgeries {
        let mut forged = good(good_tick + 1);
        forge(&mut forged);
        forger.send(forged);
        good_tick += 1;
        forger.send(good(good_tick));
    }
    let mut passed = Vec::new();
    receiver
        .drain(1000, |message| passed.push(message.envelope.tick))
        .unwrap();
    assert_eq!(
        passed,
        (10..=good_tick).collect::<Vec<_>>(),
        "every good message, and no other"
    );
    assert_eq!(receiver.newest(), &good(good_tick));
    for reason in Reason::ALL {
        let expected = forgeries
            .iter()
            .filter(|(expected, _)| *expected == reason)
            .count() as u64;
        assert_eq!(
            receiver.rejections().of(reason),
            expected,
            "{}: {reason:?}",
            C::NAME
        );
    }
    assert_eq!(receiver.rejections().total(), forgeries.len() as u64);
}

/// What can be wrong with a message of any topic that has one message a tick.
fn envelope_forgeries<C: Topic>() -> Vec<Forgery<C>> {
    vec![
        (Reason::Layout, |m| *m = zeroed()),
        (Reason::Layout, |m| m.envelope.layout ^= 1 << 63),
        (Reason::Run, |m| m.envelope.run_id -= 1),
        (Reason::Run, |m| m.envelope.run_id = 0),
        (Reason::Settings, |m| m.envelope.settings += 1),
        (Reason::Sequence, |m| m.envelope.seq -= 1),
        (Reason::Sequence, |m| m.envelope.seq = 0),
        (Reason::Sequence, |m| m.envelope.epoch = EPOCH - 1),
        (Reason::Tick, |m| m.envelope.tick = 1001),
        (Reason::Tick, |m| m.envelope.tick = NO_TICK),
        (Reason::Tick, |m| m.envelope.tick -= 1),
        (Reason::Tick, |m| m.envelope.tick = 0),
    ]
}

fn zeroed<C: Topic>() -> Message<C> {
    let mut message = good(0);
    message.envelope = Header {
        layout: 0,
        run_id: 0,
        settings: 0,
        epoch: 0,
        seq: 0,
        tick: 0,
        input_tick: [0; 3],
        ..message.envelope
    };
    message
}

#[test]
fn forged_states_are_rejected() {
    let mut forgeries = envelope_forgeries::<State>();
    forgeries.extend::<[Forgery<State>; 11]>([
        (Reason::NonFinite, |m| {
            m.content.measured.position_w_m[0] = f64::NAN
        }),
        (Reason::NonFinite, |m| {
            m.content.measured.rotor_speed_squared_mean_rad2_s2[3] = f64::INFINITY
        }),
        (Reason::NonFinite, |m| {
            m.content.truth.parameter[11] = f64::NAN
        }),
        (Reason::NonFinite, |m| {
            m.content.truth.rate_b_rad_s[2] = f64::NEG_INFINITY
        }),
        (Reason::Implausible, |m| {
            m.content.measured.position_w_m[2] = -1e6
        }),
        (Reason::Implausible, |m| {
            m.content.measured.velocity_w_m_s[1] = 1e9
        }),
        (Reason::Implausible, |m| {
            m.content.measured.rotor_speed_mean_rad_s[0] = -1.0
        }),
        (Reason::Implausible, |m| {
            m.content.measured.attitude_rad[0] = f64::MAX
        }),
        (Reason::Implausible, |m| m.content.command_saturated = 2),
        (Reason::Implausible, |m| {
            m.content.truth.position_w_m[0] = 1e300
        }),
        (Reason::Implausible, |m| {
            m.content.truth.parameter[7] = 1e300
        }),
    ]);
    assert_rejected(&forgeries);
}

#[test]
fn forged_setpoints_are_rejected() {
    let mut forgeries = envelope_forgeries::<Setpoint>();
    forgeries.extend::<[Forgery<Setpoint>; 8]>([
        (Reason::NonFinite, |m| m.content.thrust_n = f64::NAN),
        (Reason::NonFinite, |m| {
            m.content.reference.yaw_rad = f64::INFINITY
        }),
        (Reason::Implausible, |m| m.content.thrust_n = -0.1),
        (Reason::NonFinite, |m| {
            m.content.reference.snap_w_m_s4[2] = f64::NAN
        }),
        (Reason::Implausible, |m| m.content.limited = 2),
        (Reason::Implausible, |m| {
            m.content.reference.jerk_w_m_s3[1] = -1e300
        }),
        (Reason::Implausible, |m| {
            m.content.reference.yaw_acceleration_rad_s2 = 1e300
        }),
        (Reason::Implausible, |m| m.content.mode = 5),
    ]);
    assert_rejected(&forgeries);
}

#[test]
fn forged_wrenches_are_rejected() {
    let mut forgeries = envelope_forgeries::<Wrench>();
    forgeries.extend::<[Forgery<Wrench>; 3]>([
        (Reason::NonFinite, |m| m.content.torque_b_nm[1] = f64::NAN),
        (Reason::Implausible, |m| m.content.torque_b_nm[0] = 1e9),
        (Reason::Implausible, |m| m.content.mode = u64::MAX),
    ]);
    assert_rejected(&forgeries);
}

#[test]
fn forged_rotor_speeds_are_rejected() {
    let mut forgeries = envelope_forgeries::<RotorSpeeds>();
    forgeries.extend::<[Forgery<RotorSpeeds>; 4]>([
        (Reason::NonFinite, |m| m.content.speed_rad_s[3] = f64::NAN),
        (Reason::Implausible, |m| m.content.speed_rad_s[0] = -1.0),
        (Reason::Implausible, |m| m.content.speed_rad_s[1] = 1e6),
        (Reason::Implausible, |m| m.content.saturated = 7),
    ]);
    assert_rejected(&forgeries);
}

#[test]
fn forged_swap_records_are_rejected() {
    assert_rejected::<SwapRecord>(&[
        (Reason::Layout, |m| *m = zeroed()),
        (Reason::Run, |m| m.envelope.run_id += 1),
        (Reason::Sequence, |m| m.envelope.seq -= 1),
        // Several swaps may hold from one tick on, but none from a tick that is over.
        (Reason::Tick, |m| m.envelope.tick -= 2),
        (Reason::NonFinite, |m| {
            m.content.new[PARAMETERS - 1] = f64::NAN
        }),
        (Reason::Implausible, |m| {
            m.content.count = PARAMETERS as u64 + 1
        }),
        (Reason::Implausible, |m| {
            (m.content.count, m.content.parameter[0]) = (1, PARAMETERS as u64)
        }),
        (Reason::Implausible, |m| {
            (m.content.count, m.content.steps[0]) = (1, 0)
        }),
    ]);
}

#[test]
fn a_forger_of_a_later_epoch_shuts_the_sender_out_only_within_the_run() {
    let site = Site::new();
    let wire = site.wire();
    let mut receiver = armed::<Wrench>(&wire);
    let forger = Forger::<Wrench>::on(&site);
    receiver.arm(EXPECTED).unwrap();
    forger.send(good(1));
    let mut restarted = good(2);
    (restarted.envelope.epoch, restarted.envelope.seq) = (EPOCH + 1, 0);
    forger.send(restarted);
    forger.send(good(3));
    assert_eq!(
        receiver.take(3).unwrap(),
        2,
        "a predecessor that still talks is not believed"
    );
    assert_eq!(receiver.rejections().of(Reason::Sequence), 1);
    receiver.arm(EXPECTED).unwrap();
    forger.send(good(4));
    assert_eq!(receiver.take(4).unwrap(), 4);
}

/// A number of 64 bits: mostly one that some airframe may have, else one at a bound, or any.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        60 => 0.0..100.0_f64,
        1 => prop::sample::select(vec![1e4, 1e4 + 1.0, 1e5, 1e5 + 1.0, -1.0, -1e5, -1e6, f64::NAN, f64::INFINITY]),
        1 => any::<u64>().prop_map(f64::from_bits),
    ]
}

fn any_wrench() -> impl Strategy<Value = Wrench> {
    (
        prop::array::uniform10(number()),
        prop_oneof![9 => 0..5_u64, 1 => any::<u64>()],
    )
        .prop_map(|(n, mode)| {
            let mut telemetry = Telemetry::default();
            telemetry.value[..6].copy_from_slice(&n[4..10]);
            Wrench {
                thrust_n: n[0],
                torque_b_nm: [n[1], n[2], n[3]],
                mode,
                telemetry,
            }
        })
}

/// What may be believed of a wrench, written once more: thrust within 0 and 1e4 N, torque within 1e5 N m, both
/// finite, a mode that there is. Telemetry may be anything.
fn is_believable(wrench: &Wrench) -> bool {
    wrench.torque_b_nm.iter().all(|number| number.is_finite())
        && wrench.thrust_n >= 0.0
        && wrench.thrust_n <= 10_000.0
        && wrench
            .torque_b_nm
            .iter()
            .all(|torque| *torque >= -100_000.0 && *torque <= 100_000.0)
        && wrench.mode < 5
}

#[test]
fn what_is_believable_and_in_order_passes_inspection_and_nothing_else() {
    let config = ProptestConfig {
        cases: 4000,
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let (passed, refused) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    let messages = (any_wrench(), (0..20_u64, 0..20_u64, EPOCH - 1..EPOCH + 2));
    let judged = TestRunner::new(config).run(&messages, |(wrench, (seq, tick, epoch))| {
        let mut inspector = messages::inspection::Inspector::new(EXPECTED);
        prop_assert_eq!(inspector.inspect(&good::<Wrench>(8), 12), Ok(()));
        let mut message = Message {
            envelope: good::<Wrench>(tick).envelope,
            content: wrench,
        };
        (message.envelope.seq, message.envelope.epoch) = (seq, epoch);
        let in_order = (9..=12).contains(&tick) && (epoch > EPOCH || (epoch == EPOCH && seq > 8));
        let judgement = inspector.inspect(&message, 12);
        prop_assert_eq!(
            judgement.is_ok(),
            in_order && is_believable(&wrench),
            "{:?}",
            judgement
        );
        if judgement.is_ok() {
            passed.set(passed.get() + 1);
        } else {
            refused.set(refused.get() + 1);
            // What was refused leaves no trace.
            prop_assert_eq!(inspector.inspect(&good::<Wrench>(9), 12), Ok(()));
        }
        Ok(())
    });
    judged.unwrap();
    assert!(
        passed.get() > 200 && refused.get() > 200,
        "{} passed, {} refused",
        passed.get(),
        refused.get()
    );
}
