//! The functions of ../ring.h over iceoryx2 or zenoh, whichever feature is on.

use std::ffi::{CStr, c_char};

#[cfg(feature = "iceoryx2")]
mod iceoryx2_link;
#[cfg(feature = "iceoryx2")]
use iceoryx2_link::Link;
#[cfg(feature = "zenoh")]
mod zenoh_link;
#[cfg(feature = "zenoh")]
use zenoh_link::Link;

const STAGES: i32 = 4;
const BYTES: usize = 800;
type Bytes = [u8; BYTES];

/// A stage's link to the next stage and from the one before; each process has one, and one thread that calls.
static mut LINK: Option<Link> = None;

fn link() -> &'static mut Link {
    // SAFETY: only the thread of the stage calls, one function after the other.
    unsafe { (*&raw mut LINK).as_mut().expect("ring_open comes first") }
}

/// Link of the stage before.
fn before(stage: i32) -> i32 {
    (stage + STAGES - 1) % STAGES
}

/// # Safety
/// `variant` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ring_open(variant: *const c_char, stage: i32, run: u32) {
    let variant = unsafe { CStr::from_ptr(variant) };
    let link = Link::open(variant.to_str().expect("a name in UTF-8"), stage, run);
    unsafe { LINK = Some(link) };
}

/// # Safety
/// `message` points to a message.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ring_send(_: i32, message: *const Bytes) {
    link().send(unsafe { &*message });
}

/// # Safety
/// `message` points to the place for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ring_receive(_: i32, message: *mut Bytes) {
    unsafe { *message = link().receive() };
}

#[unsafe(no_mangle)]
pub extern "C" fn ring_close(_: i32) {
    unsafe { LINK = None };
}
