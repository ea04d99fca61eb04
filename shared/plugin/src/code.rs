//! Where the code of libraries lies in memory: whose it is that crashes where the rig has called nobody.
#![allow(
    unsafe_code,
    reason = "the loader's list is read; each use says why it is sound"
)]

use std::ffi::c_void;
use std::ops::Range;
use std::sync::OnceLock;

/// Libraries that are known; a process has one a role, and a trial one.
const KNOWN: usize = 16;

/// A piece of code, and the law that it belongs to.
type Code = (Range<usize>, &'static str);

/// In the order in which they were loaded. A handler may read them at any time.
static CODES: [OnceLock<Code>; KNOWN] = [const { OnceLock::new() }; KNOWN];

pub(crate) fn law_at(address: usize) -> Option<&'static str> {
    let codes = CODES.iter().map_while(OnceLock::get);
    codes
        .filter(|(code, _)| code.contains(&address))
        .map(|(_, law)| *law)
        .next()
}

/// The segment of code that an address lies in; empty where it is data, or nothing.
pub(crate) fn segment_of(address: usize) -> Range<usize> {
    let mut found = (address, 0..0);
    // SAFETY: the callback is called with the objects of this process while the call lasts, and `found` lives as long.
    unsafe { libc::dl_iterate_phdr(Some(look), (&raw mut found).cast()) };
    found.1
}

/// Remembers a law by the code that one of its functions lies in.
pub(crate) fn remember(function: usize, law: &'static str) {
    let code = segment_of(function);
    if code.is_empty() || law_at(function).is_some() {
        return;
    }
    let mut left = (code, law);
    for place in &CODES {
        match place.set(left) {
            Ok(()) => return,
            Err(still) => left = still,
        }
    }
    // There are too many: a crash of this one is not named.
}

/// Takes the segment with the function, where this object has it.
unsafe extern "C" fn look(object: *mut libc::dl_phdr_info, _: usize, found: *mut c_void) -> i32 {
    // SAFETY: the loader hands over an object with so many headers, and `remember` its own value.
    let (object, (function, code)) =
        unsafe { (&*object, &mut *found.cast::<(usize, Range<usize>)>()) };
    for i in 0..usize::from(object.dlpi_phnum) {
        // SAFETY: as above.
        let header = unsafe { &*object.dlpi_phdr.add(i) };
        let from = (object.dlpi_addr + header.p_vaddr) as usize;
        let segment = from..from + header.p_memsz as usize;
        let is_code = header.p_type == libc::PT_LOAD && header.p_flags & libc::PF_X != 0;
        if is_code && segment.contains(function) {
            *code = segment;
            return 1;
        }
    }
    0
}

/// Where a thread was as a signal came; 0 where that is not known.
#[cfg(target_arch = "x86_64")]
pub(crate) fn interrupted_at(context: *const c_void) -> usize {
    // SAFETY: the system hands such a context to a handler that has asked for it.
    let context = unsafe { &*context.cast::<libc::ucontext_t>() };
    context.uc_mcontext.gregs[libc::REG_RIP as usize] as usize
}

#[cfg(target_arch = "aarch64")]
pub(crate) fn interrupted_at(context: *const c_void) -> usize {
    // SAFETY: the system hands such a context to a handler that has asked for it.
    let context = unsafe { &*context.cast::<libc::ucontext_t>() };
    context.uc_mcontext.pc as usize
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub(crate) const fn interrupted_at(_: *const c_void) -> usize {
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_is_known_by_a_function_in_it() {
        let function = law_at as *const () as usize;
        assert_eq!(law_at(function), None);
        remember(function, "law");
        remember(function, "another");
        // Data is no code.
        assert!(segment_of((&raw const CODES).addr()).is_empty());
        assert_eq!((law_at(function), law_at(0)), (Some("law"), None));
    }
}
