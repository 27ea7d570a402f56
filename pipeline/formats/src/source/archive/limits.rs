//! Limits on reading archives.

/// Limits of an archive, and how much of them is used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    /// Maximum number of members. The largest known release in one archive has about 300,000.
    pub(super) max_members: u64,
    /// Maximum total size of the members in bytes. All of AMASS takes about 50 GB.
    pub(super) max_bytes: u64,
    /// Maximum ratio of the bytes of all members to the archive's size. Recordings compress to a tenth at best.
    pub(super) ratio: u64,
    /// Bytes up to which the ratio is not checked.
    pub(super) small: u64,
    /// Size of the archive.
    pub(super) size: u64,
    /// Members taken so far, and their bytes.
    pub(super) members: u64,
    pub(super) bytes: u64,
}

impl Budget {
    pub(super) fn new(size: u64) -> Self {
        Self {
            max_members: 1_000_000,
            max_bytes: 256 << 30,
            ratio: 200,
            small: 64 << 20,
            size,
            members: 0,
            bytes: 0,
        }
    }

    /// Bytes that further members may take.
    pub(super) fn bytes_left(&self) -> u64 {
        let by_ratio = self.size.saturating_mul(self.ratio);
        let most = by_ratio.max(self.small).min(self.max_bytes);
        most.saturating_sub(self.bytes)
    }

    /// Checks the number of members.
    ///
    /// # Errors
    /// There are too many.
    pub(super) fn allow(&self, members: u64) -> Result<(), String> {
        if members > self.max_members {
            return Err(format!(
                "the archive has more than {} members; unpack it and name the folder",
                self.max_members
            ));
        }
        Ok(())
    }

    /// Counts a member and its bytes.
    ///
    /// # Errors
    /// The member exceeds a limit, which the error names.
    pub(super) fn take(&mut self, bytes: u64) -> Result<(), String> {
        self.members += 1;
        self.allow(self.members)?;
        if bytes > self.bytes_left() {
            return Err(format!(
                "{} bytes unpack to more than {} bytes: the limits are {} times the size of the archive and {} bytes; \
                 if its files are really so large, unpack it and name the folder",
                self.size,
                self.bytes.saturating_add(self.bytes_left()),
                self.ratio,
                self.max_bytes
            ));
        }
        self.bytes += bytes;
        Ok(())
    }
}
