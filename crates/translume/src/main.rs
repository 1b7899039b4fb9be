//! The command line: parse, load, call, save. No algorithm lives here.

fn main() {}
