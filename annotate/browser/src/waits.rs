//! Waiting for the page and for programs, with a timeout.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{LazyLock, mpsc};
use std::time::{Duration, Instant};

use tokio::runtime::Runtime;

/// Timeout of every wait. It is long because test machines can be slow.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// Polling interval of a condition.
const LOOK_EVERY: Duration = Duration::from_millis(40);

/// Blocks until a WebDriver command completes. Tests are sequential; only the client is asynchronous.
pub(crate) fn wait<T>(work: impl Future<Output = T>) -> T {
    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().expect("a runtime"));
    RUNTIME.block_on(work)
}

/// Whether the condition becomes true within [`PATIENCE`].
pub(crate) fn in_time(mut is_so: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    while !is_so() {
        if begun.elapsed() > PATIENCE {
            return false;
        }
        std::thread::sleep(LOOK_EVERY);
    }
    true
}

/// A running program. It is killed when dropped.
#[derive(Debug)]
pub(crate) struct Program(Child);

impl Program {
    /// Starts a program, and waits for a line of its output that `read` can parse. An error means that there was none.
    pub(crate) fn start<T: Send + 'static>(
        command: &mut Command,
        read: impl Fn(&str) -> Option<T> + Send + 'static,
    ) -> Result<(Self, T), mpsc::RecvTimeoutError> {
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let started = command.spawn();
        let mut child = started.unwrap_or_else(|error| {
            panic!("{command:?}: {error}; start these tests through annotate/browser/run")
        });
        let lines = BufReader::new(child.stdout.take().expect("stdout is piped")).lines();
        let program = Self(child);
        let (sender, understood) = mpsc::channel();
        // Drain the rest of the output too, so that the program never blocks.
        std::thread::spawn(move || {
            for value in lines.map_while(Result::ok).filter_map(|line| read(&line)) {
                let _unheard = sender.send(value);
            }
        });
        let value = understood.recv_timeout(PATIENCE)?;
        Ok((program, value))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let ended = self.0.kill().and_then(|()| self.0.wait());
        if let Err(error) = ended {
            eprintln!("a program was not ended: {error}");
        }
    }
}
