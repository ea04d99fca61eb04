//! What a process logs while it waits for others.

use std::time::Duration;

use ipc::clock::now_ns;
use messages::role::Role;

const LOG_EVERY: Duration = Duration::from_secs(5);

pub(crate) struct ThrottledLog {
    role: Role,
    last: Option<(String, u64)>,
}

impl ThrottledLog {
    pub(crate) const fn new(role: Role) -> Self {
        Self { role, last: None }
    }

    pub(crate) fn waiting_for(&mut self, what: impl FnOnce() -> String) {
        let what = what();
        let now = now_ns();
        let due = match &self.last {
            Some((last, at)) => *last != what || now > at + LOG_EVERY.as_nanos() as u64,
            None => true,
        };
        if due {
            tracing::info!(role = self.role.name(), "waiting for {what}");
            self.last = Some((what, now));
        }
    }
}
