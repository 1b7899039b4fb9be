//! Panics of decoders that we did not write become errors.
//!
//! The exr crate (1.74) panics on some damaged B44 and PIZ blocks, and does so on its own threads, which ends the
//! process. Such blocks are decoded here under a guard, on our threads. A panic hook can ask [`is_active`] and keep
//! quiet about what is going to be an ordinary error.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static ACTIVE: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic on this thread is going to be caught and reported as an error of a file.
pub fn is_active() -> bool {
    ACTIVE.get()
}

/// What `decode` returns, `None` if it panicked. It must leave nothing behind but its result.
pub(crate) fn run<T>(decode: impl FnOnce() -> T) -> Option<T> {
    let outer = ACTIVE.replace(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    ACTIVE.set(outer);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_caught_and_the_state_restored() {
        assert_eq!(run(is_active), Some(true));
        assert_eq!(run(|| -> u8 { panic!("damaged") }), None);
        assert!(!is_active());
    }
}
