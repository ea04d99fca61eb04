//! Forged and damaged messages on real ports: rejected and counted by reason, while good ones pass.

use ipc::sys::Sealed;
use ipc::{DEEP, Receiver, TopicPorts, Wire};
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::inspection::Reason;
use messages::monitor::{CAUSES, Monitor};
use messages::parameters::PARAMETERS;
use messages::topic::Topic;

use crate::Site;
use crate::common::{EPOCH, EXPECTED};
use crate::forgery::{Draw, Forger, KINDS, good};

fn armed<C: TopicPorts>(site: &Site, wire: &Wire) -> (Receiver<C>, Forger<C>) {
    let mut receiver = wire.receiver(DEEP).unwrap();
    let forger = Forger::on(&site.instance);
    receiver.arm(EXPECTED).unwrap();
    (receiver, forger)
}

/// Sends bad messages between good ones: each good one passes, and each bad one is counted by its reason.
fn assert_rejected<C: TopicPorts + PartialEq>(
    receiver: &mut Receiver<C>,
    forger: &Forger<C>,
    reason: Reason,
    times: u64,
    mut send_bad: impl FnMut(u64),
) {
    let before = *receiver.rejections();
    receiver.arm(EXPECTED).unwrap();
    forger.send(good(10));
    for tick in 10..10 + times {
        send_bad(tick);
        forger.send(good(tick + 1));
        assert_eq!(receiver.take(tick + 1).unwrap(), tick + 1, "{reason:?}");
        assert_eq!(receiver.newest(), &good(tick + 1));
    }
    let after = receiver.rejections();
    let counted = after.of(reason) - before.of(reason);
    assert_eq!(counted, times, "{}: {reason:?}", C::NAME);
    assert_eq!(after.total() - before.total(), times);
}

/// Every kind, every single bit, and what else no airframe can have sent.
fn assert_all_rejected<C: TopicPorts + PartialEq>(forgeries: &[fn(&mut C)]) {
    let site = Site::new();
    let wire = site.wire();
    let (mut receiver, forger) = armed::<C>(&site, &wire);
    let mut draw = Draw(1);
    for (kind, reason) in KINDS {
        // Several records may be of one tick, and those of a monitor and a change hold numbers that are not used.
        if C::MANY_PER_TICK && matches!(kind, "past_tick" | "implausible")
            || C::NAME == Monitor::NAME && kind == "implausible"
        {
            continue;
        }
        let send = |tick| forger.send_bad(kind, tick, &mut draw);
        assert_rejected(&mut receiver, &forger, reason, 200, send);
    }
    let bits = 8 * size_of::<Sealed<Message<C>>>() as u64;
    let send = |tick| forger.send_flipped(good(tick + 1), tick - 10);
    assert_rejected(&mut receiver, &forger, Reason::Checksum, bits, send);
    for forge in forgeries {
        let send = |tick| {
            let mut message = good(tick + 1);
            forge(&mut message.content);
            forger.send(message);
        };
        assert_rejected(&mut receiver, &forger, Reason::Implausible, 1, send);
    }
    let send = |tick| {
        let Message { envelope, content } = good::<C>(tick);
        let (layout, run_id, settings) = (0, 0, 0);
        let envelope = Header {
            layout,
            run_id,
            settings,
            ..envelope
        };
        forger.send(Message { envelope, content });
    };
    assert_rejected(&mut receiver, &forger, Reason::Layout, 1, send);
}

#[test]
fn no_bad_message_of_any_topic_gets_through() {
    assert_all_rejected::<State>(&[
        |state| state.measured.rotor_speed_mean_rad_s[0] = -1.0,
        |state| state.measured.position_w_m[2] = -1e6,
        |state| state.command_saturated = 2,
    ]);
    assert_all_rejected::<Setpoint>(&[
        |setpoint| setpoint.thrust_n = -0.1,
        |setpoint| setpoint.limited = 2,
        |setpoint| setpoint.mode = 5,
    ]);
    assert_all_rejected::<Wrench>(&[
        |wrench| wrench.torque_b_nm[0] = 1e9,
        |wrench| wrench.mode = u64::MAX,
    ]);
    assert_all_rejected::<RotorSpeeds>(&[
        |speeds| speeds.speed_rad_s[0] = -1.0,
        |speeds| speeds.speed_rad_s[1] = 1e6,
        |speeds| speeds.saturated = 7,
    ]);
    assert_all_rejected::<SwapRecord>(&[
        |swap| swap.count = PARAMETERS as u64 + 1,
        |swap| (swap.count, swap.parameter[0]) = (1, PARAMETERS as u64),
        |swap| (swap.count, swap.steps[0]) = (1, 0),
    ]);
    assert_all_rejected::<Monitor>(&[
        |monitor| monitor.causes = 1 << CAUSES,
        |monitor| monitor.is_violation = 2,
        |monitor| monitor.is_live = 2,
    ]);
}

#[test]
fn a_forger_of_a_later_epoch_shuts_the_sender_out_only_within_the_run() {
    let site = Site::new();
    let wire = site.wire();
    let (mut receiver, forger) = armed::<Wrench>(&site, &wire);
    forger.send(good(1));
    let mut restarted = good(2);
    (restarted.envelope.epoch, restarted.envelope.seq) = (EPOCH + 1, 0);
    forger.send(restarted);
    forger.send(good(3));
    assert_eq!(receiver.take(3).unwrap(), 2, "the predecessor is rejected");
    assert_eq!(receiver.rejections().of(Reason::Sequence), 1);
    receiver.arm(EXPECTED).unwrap();
    forger.send(good(4));
    assert_eq!(receiver.take(4).unwrap(), 4);
}
