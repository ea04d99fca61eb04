//! What a process logs while it waits for others.

use std::time::Duration;

use ipc::clock::now_ns;
use messages::role::Role;

const SAY_EVERY: Duration = Duration::from_secs(5);

pub(crate) struct ThrottledLog {
    role: Role,
    said: Option<(String, u64)>,
}

impl ThrottledLog {
    pub(crate) const fn new(role: Role) -> Self {
        Self { role, said: None }
    }

    pub(crate) fn say(&mut self, what: impl FnOnce() -> String) {
        let what = what();
        let now = now_ns();
        let due = match &self.said {
            Some((said, at)) => *said != what || now > at + SAY_EVERY.as_nanos() as u64,
            None => true,
        };
        if due {
            tracing::info!(role = self.role.name(), "waiting for {what}");
            self.said = Some((what, now));
        }
    }
}
