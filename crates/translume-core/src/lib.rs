//! Random numbers, sampling, distributions and statistical tests.
//!
//! This crate knows nothing about files, pictures or scenes.

pub mod rng;
