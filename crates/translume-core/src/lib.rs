//! Frames, sampling warps, distributions, random and low-discrepancy numbers, special functions and statistical tests.
//!
//! This crate knows nothing about files, pictures or scenes. Every warp has its density beside it, and every test of the
//! project that compares a sampler with its density goes through [`chi2`].

pub mod bilinear;
pub mod chi2;
pub mod distribution;
pub mod frame;
pub mod morton;
pub mod rng;
pub mod sampler;
pub mod special;
pub mod stats;
pub mod warp;
