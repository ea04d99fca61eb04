//! What is sent is sealed with its check word, and opened where it is received.

use messages::check_word::check_word;
use messages::checks::{Check, is_on};
use messages::inspection::Reason;
use messages::layout::{Layout, words};

use crate::sys::Sealed;

impl<T: Layout> Sealed<T> {
    /// Puts the check word behind what is complete.
    #[inline]
    pub fn new(content: T) -> Self {
        Self {
            check: check_word(words(&content)),
            content,
        }
    }

    /// What was sealed. To be asked of a copy: what lies in shared memory may change after this look.
    #[inline]
    pub fn open(&self) -> Result<&T, Reason> {
        let is_whole = check_word(words(&self.content)) == self.check || !is_on(Check::Checksum);
        if is_whole {
            Ok(&self.content)
        } else {
            Err(Reason::Checksum)
        }
    }
}
