//! Read connections, used beside the writer thread: a pool, and snapshots.

use std::sync::{Condvar, Mutex, PoisonError};

use super::db::{Content, Database, Result, Work};
use super::group::caught;
use crate::Error;
use crate::lock::lock;

/// Number of read connections of a store.
const READERS: usize = 4;

/// A pool of connections, each lent to one thread at a time.
pub(crate) struct Readers<C> {
    free: Mutex<Vec<C>>,
    returned: Condvar,
}

impl<C> Readers<C> {
    /// Opens all connections.
    pub(crate) fn open(connect: impl Fn() -> Result<C>) -> Result<Self> {
        let free = (0..READERS).map(|_| connect()).collect::<Result<_, _>>()?;
        Ok(Self {
            free: Mutex::new(free),
            returned: Condvar::new(),
        })
    }

    /// Waits for a free connection and runs work on it; `end` also runs after an error or a panic.
    pub(crate) fn with(
        &self,
        work: impl FnOnce(&mut C) -> Result<()>,
        end: impl FnOnce(&mut C),
    ) -> Result<()> {
        let mut connection = {
            let mut free = lock(&self.free);
            loop {
                if let Some(connection) = free.pop() {
                    break connection;
                }
                free = self
                    .returned
                    .wait(free)
                    .unwrap_or_else(PoisonError::into_inner);
            }
        };
        let outcome = caught(|| work(&mut connection));
        end(&mut connection);
        lock(&self.free).push(connection);
        self.returned.notify_one();
        outcome
    }
}

/// A database as it was when the snapshot was taken: one transaction on a connection of its own.
pub(crate) struct Snapshot<C, R> {
    connection: Mutex<C>,
    run: R,
}

impl<C, R> Snapshot<C, R> {
    /// Takes a connection with an open transaction, and how work runs on it.
    pub(crate) fn new(connection: C, run: R) -> Self
    where
        R: Fn(&mut C, Work<'_>) -> Result<()>,
    {
        Self {
            connection: Mutex::new(connection),
            run,
        }
    }
}

impl<C, R> Database for Snapshot<C, R>
where
    C: Send,
    R: Fn(&mut C, Work<'_>) -> Result<()> + Send + Sync,
{
    fn write(&self, _: Work<'static>) -> Result<()> {
        Err(Error::Closed)
    }

    fn read(&self, work: Work<'_>) -> Result<()> {
        let mut connection = lock(&self.connection);
        caught(|| (self.run)(&mut connection, work))
    }

    fn backup(&self, _: &std::path::Path, _: Content) -> Result<()> {
        Err(Error::Closed)
    }

    fn snapshot(&self) -> Result<Box<dyn Database>> {
        Err(Error::Closed)
    }
}
