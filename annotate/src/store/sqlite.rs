//! SQLite: one file. `synchronous=FULL` makes a commit wait for the disk.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags};

use super::db::{Params, Result, Row, Tx, not_opened, read_only};
use super::migrate;
use super::pool::{Backend, Pool};
use super::store::Upgrade;
use crate::Error;

/// Prepared statements cached per connection.
const STATEMENTS: usize = 512;
/// Page cache of the writer in kilobytes: the tables of 100,000 tasks without the log.
const WRITER_CACHE_KB: usize = 64 * 1024;
/// Timeout for a lock that another process, such as `sqlite3`, holds on the file.
const BUSY: Duration = Duration::from_secs(10);

/// Name of the backup operation, for errors.
const COPY: &str = "copy itself";
/// Triggers that make the log append-only.
const TRIGGERS: &str = "
CREATE TRIGGER event_no_update BEFORE UPDATE ON event
BEGIN SELECT RAISE(ABORT, 'the log only grows'); END;
CREATE TRIGGER event_no_delete BEFORE DELETE ON event
BEGIN SELECT RAISE(ABORT, 'the log only grows'); END;";

/// A store in one file.
pub(crate) struct Sqlite {
    path: PathBuf,
}

/// Opens the file, or creates it with all tables. Also returns the upgrade, if one was made.
pub(crate) fn open(path: &Path) -> Result<(Pool<Sqlite>, Option<Upgrade>)> {
    if let Some(kind) = network_file_system(path) {
        return Err(open_error(
            path,
            format!(
                "it lies on {kind}, where locks are unreliable and a crash can \
                 destroy the file; put it on a local disk with --store FILE, or use PostgreSQL"
            ),
        ));
    }
    let sqlite = Sqlite {
        path: path.to_owned(),
    };
    let mut writer = sqlite.connect(true)?;
    let mode: String = writer
        .query_row("PRAGMA journal_mode=WAL", [], |row| row.get(0))
        .map_err(|error| open_error(path, error))?;
    if mode != "wal" {
        return Err(open_error(
            path,
            "its file system does not support a write-ahead log; put it on a local disk with --store FILE",
        ));
    }
    let upgrade = sqlite.prepare(&mut writer)?;
    Ok((Pool::open(sqlite, writer)?, upgrade))
}

fn failed(action: &'static str) -> impl Fn(rusqlite::Error) -> Error {
    move |source| match source.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => {
            read_only("the disk is full; free disk space and send the request again")
        }
        Some(ErrorCode::ReadOnly) => {
            read_only("the file or its folder is read-only; make both writable for this program")
        }
        Some(ErrorCode::SystemIoFailure) => read_only(format!(
            "the disk reports an error ({source}); check the disk"
        )),
        _ => Error::Sqlite { action, source },
    }
}

fn open_error(path: &Path, reason: impl std::fmt::Display) -> Error {
    not_opened(path.display(), reason)
}

/// The version of the tables; 0 if there are none.
fn version(tx: &mut dyn Tx) -> Result<i64> {
    tx.number("PRAGMA user_version", &[])
}

impl Sqlite {
    /// Creates the tables of a new store, or upgrades those of an older version after a copy.
    fn prepare(&self, db: &mut Connection) -> Result<Option<Upgrade>> {
        if version(db)? == migrate::VERSION {
            return Ok(None);
        }
        // An error drops the connection, which rolls back the whole transaction.
        self.begin(db, true)?;
        // Another process may have upgraded the store meanwhile.
        let found = version(db)?;
        let place = self.path.display().to_string();
        let upgrade = migrate::prepare(db, &place, found, TRIGGERS, |_| {
            let copy = unused(&self.path, found);
            self.backup(&copy, true)?;
            Ok(copy.display().to_string())
        })?;
        let end = format!("PRAGMA user_version={}; COMMIT", migrate::VERSION);
        db.batch(&end, migrate::MAKE)?;
        Ok(upgrade)
    }
}

/// An unused file name, beside the store, for its copy before an upgrade.
fn unused(path: &Path, version: i64) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = |number: u32| match number {
        1 => format!("{stem}.version-{version}.sqlite"),
        _ => format!("{stem}.version-{version}-{number}.sqlite"),
    };
    let mut number = 1;
    while path.with_file_name(name(number)).exists() {
        number += 1;
    }
    path.with_file_name(name(number))
}

/// Removes tokens from a copy, including what free pages still hold of them.
fn forget_tokens(copy: &Path) -> rusqlite::Result<()> {
    Connection::open(copy)?.execute_batch("DELETE FROM token; VACUUM")
}

/// Syncs a file to the disk, renames it, and syncs the folder, so that the new name never refers to incomplete content.
/// `sync` syncs a file or a folder.
fn publish(
    temporary: &Path,
    path: &Path,
    sync: &mut dyn FnMut(&Path) -> std::io::Result<()>,
) -> Result<()> {
    sync(temporary).map_err(datasets_spec::Error::io("write", temporary))?;
    std::fs::rename(temporary, path).map_err(datasets_spec::Error::io("rename", path))?;
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    let folder = folder.unwrap_or(Path::new("."));
    Ok(sync(folder).map_err(datasets_spec::Error::io("write folder", folder))?)
}

impl Backend for Sqlite {
    type Connection = Connection;
    const GROUP: usize = 128;
    const WRITE: &'static str = "BEGIN IMMEDIATE";
    const READ: &'static str = "BEGIN";

    fn connect(&self, writes: bool) -> Result<Connection> {
        let refuse = |error: rusqlite::Error| open_error(&self.path, error);
        let (flags, settings) = if writes {
            let settings = format!(
                "PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON; PRAGMA wal_autocheckpoint=4000; \
                 PRAGMA cache_size=-{WRITER_CACHE_KB}; PRAGMA temp_store=MEMORY;"
            );
            (OpenFlags::default(), settings)
        } else {
            let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            (flags, "PRAGMA query_only=ON".to_owned())
        };
        let db = Connection::open_with_flags(&self.path, flags).map_err(refuse)?;
        db.busy_timeout(BUSY).map_err(refuse)?;
        db.set_prepared_statement_cache_capacity(STATEMENTS);
        db.execute_batch(&settings).map_err(refuse)?;
        Ok(db)
    }

    /// The backup appears complete and on disk, or not at all.
    fn backup(&self, path: &Path, with_tokens: bool) -> Result<()> {
        if path.exists() {
            return Err(open_error(path, "the file exists; choose another name"));
        }
        let mut reader = self.connect(false)?;
        reader.batch("PRAGMA query_only=OFF", COPY)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
        let copied = (|| {
            // One read transaction copies everything; writers continue.
            reader
                .execute("VACUUM INTO ?1", [temporary.to_string_lossy().as_ref()])
                .map_err(failed(COPY))?;
            if !with_tokens {
                forget_tokens(&temporary).map_err(failed("leave tokens out"))?;
            }
            publish(&temporary, path, &mut |path| {
                std::fs::File::open(path).and_then(|file| file.sync_all())
            })
        })();
        if copied.is_err() {
            // A leftover of a failed copy only uses space.
            let _removed = std::fs::remove_file(&temporary);
        }
        copied
    }
}

/// A temporary database for one computation. SQLite keeps it in memory until it is large.
pub(crate) fn scratch() -> Result<Connection> {
    let mut db = Connection::open("").map_err(failed("make a scratch database"))?;
    db.set_prepared_statement_cache_capacity(STATEMENTS);
    // The temporary database needs no protection from a crash.
    let settings = "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; BEGIN";
    db.batch(settings, "make a scratch database")?;
    Ok(db)
}

impl Tx for Connection {
    fn execute(&mut self, sql: &str, params: Params) -> Result<u64> {
        let mut statement = self.prepare_cached(sql).map_err(failed("write"))?;
        let changed = statement.execute(params).map_err(failed("write"))?;
        Ok(changed as u64)
    }

    fn batch(&mut self, sql: &str, action: &'static str) -> Result<()> {
        self.execute_batch(sql).map_err(failed(action))
    }

    fn define(&mut self, sql: &str) -> Result<()> {
        // INTEGER PRIMARY KEY makes the id the rowid, so SQLite keeps no extra index.
        let sql = sql.replace("BIGINT PRIMARY KEY", "INTEGER PRIMARY KEY");
        self.batch(&sql, migrate::MAKE)
    }

    fn query(&mut self, sql: &str, params: Params) -> Result<Vec<Row>> {
        let read = || -> rusqlite::Result<Vec<Row>> {
            let mut statement = self.prepare_cached(sql)?;
            let columns = statement.column_count();
            let rows = statement.query_map(params, |row| {
                let values: rusqlite::Result<_> = (0..columns).map(|at| row.get(at)).collect();
                Ok(Row(values?))
            })?;
            rows.collect()
        };
        read().map_err(failed("read"))
    }
}

/// A phrase that names the network file system of a path; `None` on a local one, or if unknown.
fn network_file_system(path: &Path) -> Option<String> {
    let folder = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
    let mounts = std::fs::read_to_string("/proc/self/mounts").ok()?;
    network_mount(&mounts, &folder)
}

/// Looks up a folder in a mount table. The longest mount point above the folder counts.
fn network_mount(mounts: &str, folder: &Path) -> Option<String> {
    // File systems, with and without the prefix `fuse.`. Cluster and virtual-machine file systems are included: each
    // host maps the shared memory of the write-ahead log separately.
    const NETWORK: &str = "9p acfs afs beegfs beegfs_nodev blobfuse2 ceph ceph-fuse cifs coda cvmfs2 davfs davfs2 \
        fhgfs gcsfuse gfs2 glusterfs goofys gpfs grpcfuse juicefs kafs lustre mount-s3 mountpoint-s3 ncpfs nfs nfs4 \
        ocfs2 orangefs panfs prl_fs pvfs2 quobyte rclone s3fs seaweedfs smb2 smb3 smbfs sshfs vboxsf virtiofs vmhgfs \
        vmhgfs-fuse wekafs";
    let is_network = |kind: &str| NETWORK.split(' ').any(|name| name == kind);
    mounts
        .lines()
        .filter_map(|line| {
            let mut fields = line.split(' ').skip(1);
            let point = unescaped(fields.next()?);
            let kind = fields.next()?;
            folder.starts_with(&point).then_some((point.len(), kind))
        })
        .max_by_key(|(length, _)| *length)
        .filter(|(_, kind)| is_network(kind.strip_prefix("fuse.").unwrap_or(kind)))
        .map(|(_, kind)| format!("a network file system ({kind})"))
}

/// Decodes a path of the mount table, in which blanks and backslashes are octal escapes.
fn unescaped(text: &str) -> String {
    text.replace("\\040", " ")
        .replace("\\011", "\t")
        .replace("\\012", "\n")
        .replace("\\134", "\\")
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::store::Store;
    use super::super::{open_sqlite, project};
    use super::*;

    fn store() -> (tempfile::TempDir, Arc<Store>) {
        let dir = tempfile::tempdir().expect("a folder");
        let store = open_sqlite(&dir.path().join("s.sqlite")).expect("opens");
        (dir, store)
    }

    fn put(name: &str) -> impl FnOnce(&mut dyn Tx) -> Result<()> + Send + 'static {
        let name = name.to_owned();
        move |tx| project::put(tx, &name, "")
    }

    fn names(store: &Store) -> Vec<String> {
        let sql = "SELECT name FROM setting WHERE name <> 'id' ORDER BY name";
        store.read(|tx| tx.list(sql, &[])).expect("reads")
    }

    #[test]
    fn work_that_fails_or_panics_leaves_nothing_and_others_alone() {
        let (_dir, store) = store();
        std::thread::scope(|scope| {
            for index in 0..32 {
                let store = &store;
                scope.spawn(move || {
                    let outcome = store.write(move |tx| {
                        put(&format!("{index:02}"))(tx)?;
                        if index % 2 == 1 {
                            return Err(Error::not_found("thing"));
                        }
                        Ok(())
                    });
                    assert_eq!(outcome.is_ok(), index % 2 == 0);
                });
            }
        });
        let outcome = store.write(|tx| {
            put("a")(tx)?;
            panic!("a defect")
        });
        assert!(matches!(outcome, Err::<(), _>(Error::Closed)));
        store.write(put("b")).expect("the writer goes on");
        let mut expected: Vec<String> = (0..32).step_by(2).map(|i| format!("{i:02}")).collect();
        expected.push("b".to_owned());
        assert_eq!(names(&store), expected);
    }

    fn pragma(store: &Store, sql: &'static str) {
        store.write(move |tx| tx.query(sql, &[])).expect("a pragma");
    }

    /// Writes a row that takes a few pages.
    fn put_much(store: &Store, name: &str) -> Result<()> {
        let name = name.to_owned();
        store.write(move |tx| project::put(tx, &name, &"x".repeat(20_000)))
    }

    #[test]
    fn a_full_disk_refuses_writes_until_there_is_room_and_loses_nothing() {
        let (_dir, store) = store();
        // Limit the number of pages: SQLite then reports a full disk.
        pragma(&store, "PRAGMA max_page_count=160");
        let mut written = Vec::new();
        let refused = loop {
            let name = format!("{:03}", written.len());
            match put_much(&store, &name) {
                Ok(()) => written.push(name),
                Err(error) => break error,
            }
        };
        assert!(matches!(refused, Error::ReadOnly { .. }), "{refused}");
        assert!(refused.to_string().contains("free disk space"), "{refused}");
        assert!(!written.is_empty());
        assert_eq!(names(&store), written, "what was acknowledged can be read");
        assert!(matches!(
            put_much(&store, "again"),
            Err(Error::ReadOnly { .. })
        ));
        pragma(&store, "PRAGMA max_page_count=1000000");
        put_much(&store, "later").expect("there is room again");
        written.push("later".to_owned());
        assert_eq!(names(&store), written);
    }

    #[test]
    fn disk_space_is_named_only_when_it_is_the_matter_and_a_read_only_store_can_be_read() {
        let (dir, store) = store();
        // Another program, such as `sqlite3`, holds the file for longer than a writer waits.
        pragma(&store, "PRAGMA busy_timeout=0");
        let other = Connection::open(dir.path().join("s.sqlite")).expect("a second connection");
        other.execute_batch("BEGIN IMMEDIATE").expect("a lock");
        let locked = store.write(put("new")).expect_err("the file is locked");
        other.execute_batch("ROLLBACK").expect("unlocks");
        store.write(put("new")).expect("writes again");
        pragma(&store, "PRAGMA query_only=ON");
        let read_only = store.write(put("more")).expect_err("it is read-only");
        assert!(matches!(read_only, Error::ReadOnly { .. }));
        assert_eq!(names(&store), ["new"]);
        for (error, words) in [
            (&locked, "locked"),
            (&locked, "send the request again"),
            (&read_only, "make both writable"),
        ] {
            let text = error.to_string();
            assert!(
                text.contains(words) && !text.contains("disk space"),
                "{text}"
            );
        }
    }

    #[test]
    fn a_write_ahead_log_that_was_cut_gives_what_came_before() {
        let (dir, store) = store();
        let written: Vec<String> = (0..12).map(|number| format!("{number:03}")).collect();
        for name in &written {
            put_much(&store, name).expect("writes");
        }
        let log = std::fs::read(dir.path().join("s.sqlite-wal")).expect("a log");
        for cut in 0..8 {
            // A store that a crash left behind, with the end of its log missing.
            let crashed = tempfile::tempdir().expect("a folder");
            let path = crashed.path().join("s.sqlite");
            std::fs::copy(dir.path().join("s.sqlite"), &path).expect("a copy");
            let kept = &log[..log.len() - cut * log.len() / 8];
            std::fs::write(crashed.path().join("s.sqlite-wal"), kept).expect("a copy");
            // The database file is still empty. If the cut removes the first transaction, the tables are created again.
            let reopened = open_sqlite(&path).expect("opens without repair");
            let found = names(&reopened);
            assert_eq!(found, written[..found.len()], "a prefix, in order");
            assert_eq!(cut == 0, found.len() == written.len());
            reopened.write(put("later")).expect("goes on");
        }
    }

    #[test]
    fn the_log_takes_no_changes() {
        let (_dir, store) = store();
        let run = |sql: &'static str| store.write(move |tx| tx.execute(sql, &[]));
        run("INSERT INTO event (seq, at, kind, body, version) VALUES (1, 0, 'imported', '{}', 1)")
            .expect("inserts");
        for sql in ["UPDATE event SET at = 1", "DELETE FROM event"] {
            assert!(run(sql).is_err(), "{sql}");
        }
    }

    #[test]
    fn a_copy_is_on_the_disk_before_it_has_its_name() {
        let dir = tempfile::tempdir().expect("a folder");
        let [temporary, path] = ["copy.tmp", "copy"].map(|name| dir.path().join(name));
        let mut synced = Vec::new();
        std::fs::write(&temporary, "copy").expect("writes");
        let full = publish(&temporary, &path, &mut |_: &Path| {
            Err(std::io::Error::other("full"))
        });
        assert!(full.is_err() && !path.exists());
        let mut note = |of: &Path| {
            synced.push((of.to_owned(), path.exists()));
            Ok(())
        };
        publish(&temporary, &path, &mut note).expect("a copy");
        let folder = dir.path().to_owned();
        assert_eq!(synced, [(temporary, false), (folder, true)]);
    }

    #[test]
    fn network_file_systems_are_known_by_their_mount() {
        let network =
            "nfs nfs4 cifs smb3 gpfs beegfs lustre 9p virtiofs ceph fuse.sshfs fuse.juicefs";
        let local = "ext4 xfs btrfs zfs tmpfs overlay fuseblk fuse.mergerfs";
        for (kinds, root, is_network) in [(network, "ext4", true), (local, "nfs", false)] {
            for kind in kinds.split(' ') {
                let mounts = format!("share / {root} rw 0 0\nshare /data {kind} rw 0 0\n");
                let found = network_mount(&mounts, Path::new("/data/set"));
                assert_eq!(found.is_some(), is_network, "{kind}");
                assert!(found.is_none_or(|said| said.contains(kind)), "{kind}");
            }
        }
        let mounts = "/dev/sda1 / ext4 rw 0 0\nserver:/home /home nfs4 rw 0 0\n/dev/sdb /home/fast\\040disk xfs rw 0 0\n";
        for (folder, is_network) in [
            ("/srv/data", false),
            ("/home/ann", true),
            ("/home/fast disk/data", false),
        ] {
            let found = network_mount(mounts, Path::new(folder));
            assert_eq!(found.is_some(), is_network, "{folder}");
        }
    }
}
