//! A hash over several parts.

/// BLAKE3 over parts. The length of each part comes before it and keeps `["ab", "c"]` apart from `["a", "bc"]`.
#[derive(Clone, Debug, Default)]
pub struct Digest(blake3::Hasher);

impl Digest {
    /// Adds a part.
    pub fn part(&mut self, part: &(impl AsRef<[u8]> + ?Sized)) {
        let part = part.as_ref();
        self.0.update(&(part.len() as u64).to_le_bytes());
        self.0.update(part);
    }

    /// The hash in hexadecimal.
    pub fn hex(&self) -> String {
        self.0.finalize().to_hex().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lengths_of_the_parts_are_hashed() {
        let mut digest = Digest::default();
        digest.part("ab");
        digest.part(b"c");
        let bytes = b"\x02\0\0\0\0\0\0\0ab\x01\0\0\0\0\0\0\0c";
        assert_eq!(digest.hex(), blake3::hash(bytes).to_hex().to_string());
    }
}
