//! What every input is held to: time, memory and stack bounded, no panic.
//!
//! Memory is counted by the global allocator of this crate. What exceeds a bound cannot be stopped in any other way
//! than by ending the process: a line on standard error says why, the parent does the rest.

#![allow(unsafe_code, reason = "a global allocator, which counts, can only be written so")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Processor seconds that one input may take.
pub const MOST_SECONDS: f64 = 5.0;
/// Seconds on the clock, for what waits instead of working.
const MOST_WAITING: f64 = 60.0;
/// Stack of the thread that reads: what threads of Rust programs have when nothing else is said.
const STACK: usize = 2 << 20;

/// Begins the lines that tell why a process ended.
pub const MARK: &str = "fuzz: ";

/// The system's allocator with the sum of what is in use, and a limit on it.
struct Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

// SAFETY: every call goes to the system's allocator unchanged; the counters are atomic and allocate nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        grow(size.saturating_sub(layout.size()));
        IN_USE.fetch_sub(layout.size().saturating_sub(size), Relaxed);
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn grow(bytes: usize) {
    let now = IN_USE.fetch_add(bytes, Relaxed).saturating_add(bytes);
    // Lifted before anything else is asked for, so that this happens once.
    if now > LIMIT.load(Relaxed) && LIMIT.swap(usize::MAX, Relaxed) != usize::MAX {
        end(format_args!("memory: {} MiB are in use, the last request was of {bytes} bytes", now >> 20));
    }
}

/// Says why and ends the process.
fn end(why: std::fmt::Arguments<'_>) -> ! {
    let _ = writeln!(std::io::stderr(), "{MARK}{why}");
    std::process::abort()
}

/// When the input at hand began, in milliseconds since [`watch`], or 0; and the processor's time then.
static BEGUN: AtomicU64 = AtomicU64::new(0);
static BEGUN_CPU: AtomicU64 = AtomicU64::new(0);
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Milliseconds that this process has worked, where the system tells.
fn cpu_millis() -> Option<u64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_ascii_whitespace().collect();
    // Fields 14 and 15, of which the first two are off, in ticks of 10 ms.
    Some(10 * (fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?))
}

/// Starts the thread that ends the process when an input takes too long, and the hook that remembers panics. Once a
/// process.
pub fn watch() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(|panic| {
            // Under the guard it is a damaged file that another's decoder gave up, as in the program.
            if !translume_image::guard::is_active() {
                let at = panic.location().map(|l| format!("{}:{}", l.file(), l.line())).unwrap_or_default();
                let what = panic.payload_as_str().unwrap_or("unknown").replace('\n', " ");
                if BEGUN.load(Relaxed) == 0 {
                    // No reader is at work: a fault of the fuzzer itself.
                    let _ = writeln!(std::io::stderr(), "the fuzzer itself panics at {at}: {what}");
                }
                let mut told = PANIC.lock().unwrap_or_else(PoisonError::into_inner);
                told.get_or_insert(format!("panic at {at}: {what}"));
            }
        }));
        let start = Instant::now();
        clock(start);
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_millis(100));
                let begun = BEGUN.load(Relaxed);
                if begun == 0 {
                    continue;
                }
                let waited = (millis(start).saturating_sub(begun)) as f64 / 1e3;
                let worked = cpu_millis().map_or(waited, |c| c.saturating_sub(BEGUN_CPU.load(Relaxed)) as f64 / 1e3);
                // Two cores may work at it; a busy machine gives it less than the clock says.
                if BEGUN.load(Relaxed) == begun && (worked > 2.0 * MOST_SECONDS || waited > MOST_WAITING) {
                    end(format_args!("time: not done after {worked:.0} s of work"));
                }
            }
        });
    });
}

fn clock(start: Instant) {
    START.get_or_init(|| start);
}

static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();

fn millis(start: Instant) -> u64 {
    start.elapsed().as_millis() as u64 + 1
}

/// Runs `read` on a thread of its own with `memory` bytes beside what is in use; `Err` says what went wrong. A time or
/// memory out of bounds ends the process, as a stack that overflows does.
///
/// # Errors
/// The panic's place and message.
pub fn hold<T: Send>(memory: usize, read: impl FnOnce() -> T + Send) -> Result<T, String> {
    watch();
    *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = None;
    BEGUN_CPU.store(cpu_millis().unwrap_or(0), Relaxed);
    LIMIT.store(IN_USE.load(Relaxed).saturating_add(memory), Relaxed);
    BEGUN.store(START.get().map_or(1, |s| millis(*s)), Relaxed);
    let result = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK);
        let thread = thread.spawn_scoped(scope, || catch_unwind(AssertUnwindSafe(read)).ok());
        thread.ok().and_then(|t| t.join().ok().flatten())
    });
    BEGUN.store(0, Relaxed);
    LIMIT.store(usize::MAX, Relaxed);
    // A panic on another thread that nobody heard of counts too.
    let told = PANIC.lock().unwrap_or_else(PoisonError::into_inner).take();
    match (result, told) {
        (Some(result), None) => Ok(result),
        (_, told) => Err(told.unwrap_or_else(|| "panic".into())),
    }
}
