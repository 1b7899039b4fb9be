//! Fuzzers for every reader of the project, by mutation within the process, on a stable compiler.
//!
//! A [`target`](targets::TARGETS) is a reader and what its results promise. The [driver](drive) runs a
//! [worker] process for each: it draws a seed from the corpus or from what was found new, [mutates](mutate)
//! it, and reads it within [bounds] of time, memory and stack. A worker that dies is a finding: its input is kept,
//! [made smaller](minimise), and the next worker goes on. A seed gives the same inputs again; only how many there are
//! depends on the time. Without the compiler's coverage, what is new is told by what readers say: an error or warning
//! text that has not been seen (numbers and names apart) makes its input a seed.
//!
//! This crate knows every library and no option of the program.

pub mod bounds;
pub mod drive;
pub mod input;
pub mod minimise;
pub mod mutate;
pub mod seeds;
pub mod targets;
pub mod worker;
