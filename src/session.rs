//! Services of the process for the library crates: signals, clock, progress sink.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock, Once};
use std::time::Instant;

use anyhow::bail;
use datasets_spec::Progress;
use remote_store::hub::HubCache;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use train::Session;
use train::model::pass::Arithmetic;
use train::registry::has_frozen_text;
use train::text::source::TextEncoderSource;
use train::work::Surroundings;

use crate::device::{arithmetic, device, devices, training_arithmetic};
use crate::exit::{Exit, Stopped};

/// Set by the first interrupt; training then saves and ends.
static STOP: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Fails after an interrupt.
pub(crate) fn go_on() -> Result<(), Stopped> {
    match STOP.load(Ordering::Relaxed) {
        true => Err(Stopped),
        false => Ok(()),
    }
}

/// Makes the first interrupt set `STOP`, and a second one end the program at once.
fn listen_for_interrupts() {
    static LISTENING: Once = Once::new();
    LISTENING.call_once(|| {
        for signal in [SIGINT, SIGTERM] {
            let second = Exit::Interrupted.code().into();
            // Registered first, so that it sees the flag before this signal sets it. Failures are ignored: without a
            // handler a signal ends the program at once, which loses only the steps since the last checkpoint.
            let _ = flag::register_conditional_shutdown(signal, second, Arc::clone(&STOP));
            let _ = flag::register(signal, Arc::clone(&STOP));
        }
    });
}

/// Runs a training, in the precision that the user chose for trainings.
pub(crate) fn with_training<T>(
    progress: &dyn Progress,
    act: impl FnOnce(&Session<'_>) -> Result<T, train::Error>,
) -> Result<T, train::Error> {
    in_session(progress, training_arithmetic(), act)
}

/// Runs a stage that edits.
pub(crate) fn with_session<T>(
    progress: &dyn Progress,
    act: impl FnOnce(&Session<'_>) -> Result<T, train::Error>,
) -> Result<T, train::Error> {
    in_session(progress, arithmetic(), act)
}

fn in_session<T>(
    progress: &dyn Progress,
    arithmetic: Arithmetic,
    act: impl FnOnce(&Session<'_>) -> Result<T, train::Error>,
) -> Result<T, train::Error> {
    listen_for_interrupts();
    let begun = Instant::now();
    act(&Session {
        device: &device(),
        more_devices: &devices()[1..],
        arithmetic,
        progress,
        stop: &STOP,
        clock: &|| begun.elapsed(),
    })
}

/// The cache of the Hugging Face hub that the environment names.
pub(crate) fn hub_cache() -> Option<HubCache> {
    HubCache::from_variables(|name| std::env::var_os(name))
}

/// Settings of this process that a job with a model needs and its plan does not hold.
pub(crate) fn surroundings() -> Surroundings {
    Surroundings {
        device: device(),
        arithmetic: arithmetic(),
        cache: hub_cache(),
    }
}

/// Source of a frozen text encoder: the user's path, or otherwise CLIP in the hub's cache.
pub(crate) fn text_encoder(given: Option<&Path>) -> TextEncoderSource {
    TextEncoderSource {
        given: given.map(Path::to_owned),
        cache: hub_cache(),
    }
}

/// Refuses a text encoder that a trained run would ignore, because it has learned its words. A plan has one text
/// encoder for all its systems, so only one that is given to this run must be used.
pub(crate) fn refuse_unused_encoder(run: &Path, given: Option<&Path>) -> anyhow::Result<()> {
    if given.is_some() && !has_frozen_text(run)? {
        bail!(
            "the run {} makes no use of --text-encoder; leave it out",
            run.display()
        );
    }
    Ok(())
}
