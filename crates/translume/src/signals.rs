//! SIGINT and SIGTERM: work that can keep what there is is asked to end, any other ends at once, and in both cases no
//! temporaries stay. The exit status is 128 and the signal's number, as shells and batch queues expect.

use anyhow::Context as _;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Signals listened to; SIGHUP, SIGINT and SIGTERM have these numbers wherever they exist.
const SIGNALS: &[i32] = if cfg!(unix) { &[1, 2, 15] } else { &[2, 15] };
/// A handler may do next to nothing, so a thread looks this often at what it noted.
const INTERVAL: Duration = Duration::from_millis(20);

/// Exit status of the first signal that came, 0 before.
static STATUS: AtomicU8 = AtomicU8::new(0);
/// What the running verb looks at to end early.
static STOP: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);
static PENDING: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// Listens from now on. Once a process; a second call changes nothing.
///
/// # Errors
/// The system refuses.
pub(crate) fn listen() -> anyhow::Result<()> {
    let pending = Arc::new(AtomicUsize::new(0));
    if PENDING.set(pending.clone()).is_err() {
        return Ok(());
    }
    for &signal in SIGNALS {
        signal_hook::flag::register_usize(signal, pending.clone(), signal as usize)
            .context("cannot listen for signals")?;
    }
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || watch(&pending))
        .context("no thread for signals")?;
    Ok(())
}

fn watch(pending: &AtomicUsize) {
    loop {
        std::thread::sleep(INTERVAL);
        let signal = pending.swap(0, Ordering::Relaxed);
        if signal == 0 {
            continue;
        }
        let status = 128 + signal as u8;
        let _ = STATUS.compare_exchange(0, status, Ordering::Relaxed, Ordering::Relaxed);
        let stop = STOP.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // Asked a second time, work that ends too slowly for somebody ends at once.
        if stop.is_none_or(|stop| stop.swap(true, Ordering::Relaxed)) {
            translume_image::atomic::clean_up();
            std::process::exit(status.into());
        }
    }
}

/// For work that keeps what there is: becomes true when a signal asks for an end. A second signal ends the program at once.
pub(crate) fn stop_flag() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    *STOP.lock().unwrap_or_else(PoisonError::into_inner) = Some(flag.clone());
    flag
}

/// Exit status that the signal that came asks for.
pub(crate) fn status() -> Option<u8> {
    Some(STATUS.load(Ordering::Relaxed)).filter(|s| *s != 0)
}
