//! A spare: the process of a stage that waits beside it, with everything done that needs no place in the flight.
//!
//! It has its settings, its law, and its memory locked and touched. It holds no lock, no node of the middleware, no
//! port, no board and no real-time priority, keeps off the loops' processor, and waits in a read. Its launcher's byte on
//! standard input has it go on and take the place of a stage that has died. The end of standard input, which is also the
//! launcher's, ends it.

use rustix::io::Errno;
use rustix::stdio::stdin;
use rustix::thread::set_name;

use crate::launcher::end_with_launcher;
use crate::rt::Ahead;
use crate::station::Orders;
use model::role::Role;
use wire::clock::now_ns;
use wire::error::Error;

/// What a spare is called while it waits, as `ps -o comm` and `top` show it.
pub const NAME: &std::ffi::CStr = c"ironbird spare";
/// What it is called when it goes on.
const NAME_OF_A_STAGE: &std::ffi::CStr = c"ironbird";

/// Does what can be done ahead, and waits; whether the spare is to go on, and when it was told to is in its orders then.
///
/// # Errors
/// [`Error::Interrupted`] where the launcher is dead already; [`Error::System`].
pub fn stand_by(role: Role, orders: &mut Orders) -> Result<bool, Error> {
    end_with_launcher(orders.launcher)?;
    orders.ahead = Ahead::prepare(role, &orders.rt);
    let named = |name| set_name(name).map_err(|e| Error::system("cannot name the process", e));
    named(NAME)?;
    let is_told = is_told().map_err(|e| Error::system("cannot read whether the spare is to go on", e))?;
    orders.begun_ns = now_ns();
    named(NAME_OF_A_STAGE)?;
    Ok(is_told)
}

/// Waits for a byte, or for the end of what can come.
fn is_told() -> Result<bool, Errno> {
    let mut byte = [0_u8];
    loop {
        match rustix::io::read(stdin(), &mut byte) {
            Ok(bytes) => return Ok(bytes > 0),
            Err(Errno::INTR) => {}
            Err(e) => return Err(e),
        }
    }
}
