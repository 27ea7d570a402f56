//! Limits on reading archives.

/// Limits on one archive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Maximum number of members. The largest known release in one archive has about 300,000.
    pub(super) members: u64,
    /// Maximum total size of the members in bytes. All of AMASS takes about 50 GB.
    pub(super) bytes: u64,
    /// Maximum ratio of the bytes of all members to the archive's size. Recordings compress to a tenth at best.
    pub(super) ratio: u64,
    /// Bytes up to which the ratio is not checked.
    pub(super) small: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            members: 1_000_000,
            bytes: 256 << 30,
            ratio: 200,
            small: 64 << 20,
        }
    }
}

/// Remaining limits of an archive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    limits: Limits,
    /// Size of the archive.
    size: u64,
    members: u64,
    bytes: u64,
}

impl Budget {
    pub(super) fn new(limits: Limits, size: u64) -> Self {
        Self {
            limits,
            size,
            members: 0,
            bytes: 0,
        }
    }

    /// Size of the archive.
    pub(super) fn size(&self) -> u64 {
        self.size
    }

    /// Bytes that further members may take.
    pub(super) fn bytes_left(&self) -> u64 {
        let by_ratio = self.size.saturating_mul(self.limits.ratio);
        let most = by_ratio.max(self.limits.small).min(self.limits.bytes);
        most.saturating_sub(self.bytes)
    }

    /// Counts a member.
    ///
    /// # Errors
    /// The limit that the member exceeds.
    pub(super) fn take(&mut self, bytes: u64) -> Result<(), String> {
        self.members += 1;
        let Limits {
            members,
            bytes: most,
            ratio,
            ..
        } = self.limits;
        if self.members > members {
            return Err(format!(
                "the archive has more than {members} members; unpack it and name the folder"
            ));
        }
        if bytes > self.bytes_left() {
            return Err(format!(
                "{} bytes unpack to more than {} bytes: the limits are {ratio} times the size of the archive and \
                 {most} bytes; if its files are really so large, unpack it and name the folder",
                self.size,
                self.bytes.saturating_add(self.bytes_left())
            ));
        }
        self.bytes += bytes;
        Ok(())
    }
}
