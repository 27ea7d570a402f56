//! Pictures of the guide, stored as Base64 text.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::db::{Result, params, unreadable};
use super::entry::Body;
use super::log;
use super::records::Millis;
use super::settings::check_picture_name;
use super::store::Store;
use crate::error::{Error, require};
use crate::wire::{MAX_PICTURE_BYTES, PictureInfo};

/// Maximum number of pictures.
const MAX_PICTURES: i64 = 100;
/// MIME types by the first bytes of a picture.
const TYPES: [(&[u8], &str); 4] = [
    (b"\x89PNG\r\n\x1a\n", "image/png"),
    (b"\xff\xd8\xff", "image/jpeg"),
    (b"GIF8", "image/gif"),
    (b"RIFF", "image/webp"),
];

impl Store {
    /// Pictures of the guide, without their content.
    pub fn pictures(&self) -> Result<Vec<PictureInfo>> {
        // Base64 writes three bytes as four characters, of which up to two are padding.
        let sql = "SELECT name, mime, LENGTH(bytes) / 4 * 3 - CASE
            WHEN bytes LIKE '%==' THEN 2 WHEN bytes LIKE '%=' THEN 1 ELSE 0 END FROM picture ORDER BY name";
        let found: Vec<(String, String, i64)> = self.read(|tx| tx.list(sql, &[]))?;
        let info = |(name, mime, bytes): (String, String, i64)| PictureInfo {
            name,
            mime,
            bytes: usize::try_from(bytes).unwrap_or(0),
        };
        Ok(found.into_iter().map(info).collect())
    }

    /// Type and content of a picture of the guide. Refused with `not_found`.
    pub fn picture(&self, name: &str) -> Result<(String, Vec<u8>)> {
        let sql = "SELECT mime, bytes FROM picture WHERE name = ?1";
        let found = self.read(|tx| tx.find(sql, params![name]))?;
        let (mime, text): (String, String) = found.ok_or_else(|| Error::not_found("picture"))?;
        Ok((mime, decoded(&text)?))
    }

    /// Stores a picture of the guide, replacing one with the same name. Refused with `invalid`.
    pub fn put_picture(
        &self,
        actor: i64,
        name: &str,
        bytes: Vec<u8>,
        now: Millis,
    ) -> Result<PictureInfo> {
        let name = name.to_owned();
        self.write(move |tx| {
            check_picture_name(&name)?;
            let problem = "this is no PNG, JPEG, GIF or WebP; convert the picture";
            let mime = mime(&bytes).ok_or_else(|| Error::invalid("body", problem))?;
            let is_small = bytes.len() <= MAX_PICTURE_BYTES;
            require(is_small, "body", "the picture is larger than 2 MB")?;
            let sql = "SELECT COUNT(*) FROM picture WHERE name <> ?1";
            let others = tx.number(sql, params![&name])?;
            let problem = format!("there are {MAX_PICTURES} pictures already; delete one");
            require(others < MAX_PICTURES, "name", problem)?;
            tx.run(
                "INSERT INTO picture (name, mime, bytes, at) VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (name) DO UPDATE SET mime = excluded.mime, bytes = excluded.bytes, at = excluded.at",
                params![&name, mime, STANDARD.encode(&bytes), now],
            )?;
            let info = PictureInfo {
                name: name.clone(),
                mime: mime.to_owned(),
                bytes: bytes.len(),
            };
            let hash = Some(blake3::hash(&bytes).to_hex().to_string());
            let body = Body::GuidePicture { name, hash };
            log::note(tx, now, Some(actor), None, body)?;
            Ok(info)
        })
    }

    /// Deletes a picture of the guide. Refused with `not_found`.
    pub fn delete_picture(&self, actor: i64, name: &str, now: Millis) -> Result<()> {
        let name = name.to_owned();
        self.write(move |tx| {
            if tx.execute("DELETE FROM picture WHERE name = ?1", params![&name])? == 0 {
                return Err(Error::not_found("picture"));
            }
            let body = Body::GuidePicture { name, hash: None };
            log::note(tx, now, Some(actor), None, body)
        })
    }
}

/// The MIME type of a picture; `None` for other files, including SVG, which may contain scripts.
fn mime(bytes: &[u8]) -> Option<&'static str> {
    let (_, mime) = TYPES.iter().find(|(start, _)| bytes.starts_with(start))?;
    let is_webp = bytes.get(8..12) == Some(b"WEBP");
    (*mime != "image/webp" || is_webp).then_some(*mime)
}

fn decoded(text: &str) -> Result<Vec<u8>> {
    STANDARD
        .decode(text)
        .map_err(|error| unreadable("picture", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pictures_without_scripts_are_pictures() {
        assert_eq!(mime(b"\x89PNG\r\n\x1a\n...."), Some("image/png"));
        assert_eq!(mime(b"RIFF....WEBPVP8 "), Some("image/webp"));
        for other in [&b"RIFF....WAVEfmt "[..], b"<svg onload='x'>", b"GIF", b""] {
            assert_eq!(mime(other), None);
        }
        assert!(check_picture_name("right-1.png").is_ok());
        for bad in ["", "../x", "a b", "a/b"] {
            assert!(check_picture_name(bad).is_err(), "{bad:?}");
        }
    }
}
