//! The hierarchical model at the size of the paper's: 9k vertices, 110k kernels, on synthetic data. Prints a table in Markdown.
//!
//! `bench-scatter [complete] [size] [relight] [resample]`: these parts, or all of them.

mod complete;
mod relight;
mod resample;
mod shape;

fn main() -> anyhow::Result<()> {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let runs = |part: &str| wanted.is_empty() || wanted.iter().any(|w| w == part);
    println!("| what | value |\n|---|---|");
    if runs("complete") {
        complete::held_out();
        complete::large();
    }
    if runs("size") || runs("relight") {
        relight::run()?;
    }
    if runs("resample") {
        resample::run()?;
    }
    Ok(())
}

/// A line of the table.
fn row(what: &str, value: String) {
    println!("| {what} | {value} |");
}

/// Seconds of all processors that this program has used so far, where the system tells: on a busy machine that says more than the clock.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(") ").next().unwrap_or_default().split(' ').collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(f64::NAN);
    (ticks(11) + ticks(12)) / 100.0
}

/// Largest resident memory so far, in MB, where the system tells.
fn peak_mb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? / 1024)
}
