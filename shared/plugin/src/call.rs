//! Calls of a library: who is called is known while it lasts, and how the thread computes is the same after it.
//!
//! A call that is no tick is waited for, and not for ever.

use std::cell::Cell;
use std::io::{self, Write as _};
use std::sync::atomic::{Ordering, compiler_fence};
use std::sync::mpsc::channel;
use std::sync::{Arc, Weak};
use std::thread;
use std::time::{Duration, Instant};

use crate::modes::Modes;
use crate::process_exit::end_now;

/// How long a call may last, outside of ticks, before it is said that it is waited for.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long it may last: Python with large packages takes seconds.
const LONGEST: Duration = Duration::from_secs(45);

/// A call, in words that are never freed: a handler may read them at any time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Call {
    pub(crate) law: &'static str,
    /// What the call does; a tick may follow.
    pub(crate) doing: &'static str,
    /// Its tick, where it is one.
    pub(crate) tick: Option<u64>,
}

impl Call {
    pub(crate) const fn new(law: &'static str, doing: &'static str) -> Self {
        Self {
            law,
            doing,
            tick: None,
        }
    }

    pub(crate) const fn tick(law: &'static str, tick: u64) -> Self {
        Self {
            law,
            doing: "in tick ",
            tick: Some(tick),
        }
    }

    /// Makes the call; says whether it has left the thread computing in another way, which is put back.
    ///
    /// Not inlined: what the rig computes before and after it is not moved in between.
    #[inline(never)]
    pub(crate) fn make<T>(self, act: impl FnOnce() -> T) -> (T, bool) {
        let outer = enter(Some(self));
        let modes = Modes::now();
        let made = act();
        let has_changed = modes.put_back();
        // Not before: exceptions that trap may do so until then. One call may stand in another, as where a stack is
        // unwound.
        enter(outer);
        (made, has_changed)
    }

    /// Makes a call that may take its time, but not for ever.
    pub(crate) fn wait<T>(self, act: impl FnOnce() -> T) -> T {
        let (starts, has_started) = channel::<()>();
        let lasting = Arc::new(());
        let lasts = Arc::downgrade(&lasting);
        thread::scope(|scope| {
            let watch = thread::Builder::new()
                .name("law".into())
                .stack_size(64 << 10);
            // Without a thread, the call is not watched.
            let watcher = watch.spawn_scoped(scope, move || {
                drop(starts);
                self.watch(&lasts);
            });
            // A thread that starts while a library is loaded waits for the loader's lock.
            let _ = has_started.recv();
            let (made, _) = self.make(act);
            drop(lasting);
            if let Ok(watcher) = watcher {
                watcher.thread().unpark();
            }
            made
        })
    }

    /// Takes no loader's lock: nothing in it makes a thread-local with a destructor.
    fn watch(self, lasts: &Weak<()>) {
        let is_away = |time: Duration| {
            let until = Instant::now() + time;
            while lasts.strong_count() > 0 && Instant::now() < until {
                thread::park_timeout(until.saturating_duration_since(Instant::now()));
            }
            lasts.strong_count() > 0
        };
        let Self { law, doing, .. } = self;
        if is_away(PATIENCE) {
            // There is no other place to say so.
            let _ = writeln!(
                io::stderr(),
                "still waiting for {law}: it has not come back within {PATIENCE:?} {doing}"
            );
            if is_away(LONGEST - PATIENCE) {
                let _ = writeln!(
                    io::stderr(),
                    "error: {law} failed {doing}: it did not come back within {LONGEST:?}"
                );
                end_now(1);
            }
        }
    }
}

thread_local! {
    // Const-initialised and without a destructor: a handler may read them at any time.
    static CALL: Cell<Call> = const { Cell::new(Call::new("", "")) };
    static IS_IN: Cell<bool> = const { Cell::new(false) };
}

pub(crate) fn call() -> Option<Call> {
    IS_IN.get().then(|| CALL.get())
}

/// Enters a call, or leaves it; gives the one before. A handler in between finds none, and never half of one.
fn enter(next: Option<Call>) -> Option<Call> {
    let before = call();
    IS_IN.set(false);
    compiler_fence(Ordering::SeqCst);
    if let Some(next) = next {
        CALL.set(next);
        compiler_fence(Ordering::SeqCst);
        IS_IN.set(true);
    }
    compiler_fence(Ordering::SeqCst);
    before
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_in_a_call_leaves_the_outer_one_known() {
        let known = || call().map(|call| (call.law, call.doing, call.tick));
        assert_eq!(known(), None);
        let ((inner, outer), _) = Call::tick("law", 7).make(|| {
            let inner = Call::new("law", "as it was freed").make(known).0;
            (inner, known())
        });
        assert_eq!(inner, Some(("law", "as it was freed", None)));
        assert_eq!((outer, known()), (Some(("law", "in tick ", Some(7))), None));
    }
}
