//! What is sent is sealed with its check word, and opened where it is received.

use model::check_word::check_word;
use model::guards::{Guard, is_on};
use model::inspection::Reason;
use model::layout::{Layout, words};

use crate::sys::Sealed;

impl<T: Layout> Sealed<T> {
    /// Puts the check word behind what is complete.
    #[inline]
    pub fn new(content: T) -> Self {
        Self { check: check_word(words(&content)), content }
    }

    /// What was sealed. To be asked of a copy: what lies in shared memory may change after this look.
    ///
    /// # Errors
    /// [`Reason::Checksum`] where a bit of it, or of the check word, has changed since.
    #[inline]
    pub fn open(&self) -> Result<&T, Reason> {
        let is_whole = check_word(words(&self.content)) == self.check || !is_on(Guard::Checksum);
        if is_whole { Ok(&self.content) } else { Err(Reason::Checksum) }
    }
}
