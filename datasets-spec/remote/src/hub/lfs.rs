//! Large files, which are uploaded before the commit that names them.
//!
//! # Source
//! Git LFS batch API, with the transfer `multipart` of the hub (`huggingface_hub/lfs.py`).

use datasets_spec::Progress;
use serde_json::{Value, json};

use super::client::{Hub, JSON, text_of};
use super::content::HubFile;
use super::error::Error;
use super::repo::Repo;

/// Files per request for upload addresses. The addresses are valid for a limited time.
const BATCH: usize = 32;
const LFS: &str = "application/vnd.git-lfs+json";

#[derive(Clone)]
pub(super) struct Object<'a> {
    pub(super) file: &'a HubFile,
    /// SHA-256, hexadecimal.
    pub(super) oid: String,
    pub(super) size: u64,
}

/// Uploads the objects that the storage lacks, and returns their number and total bytes. Objects of an interrupted
/// upload are not sent again.
pub(super) fn send(
    hub: &Hub,
    repo: &Repo,
    revision: &str,
    objects: &[Object<'_>],
    progress: &dyn Progress,
) -> Result<(usize, u64), Error> {
    let address = format!("{}.git/info/lfs/objects/batch", repo.address(hub));
    let (mut count, mut bytes) = (0, 0);
    for batch in objects.chunks(BATCH) {
        let asked = batch
            .iter()
            .map(|object| json!({ "oid": object.oid, "size": object.size }));
        let asked = json!({
            "operation": "upload",
            "transfers": ["basic", "multipart"],
            "hash_algo": "sha256",
            "ref": { "name": revision },
            "objects": Vec::from_iter(asked),
        });
        let answer = hub
            .post(&address, LFS, asked.to_string().as_bytes())?
            .checked()?;
        let places = answer.body["objects"].as_array();
        let places = places.ok_or_else(|| answer.malformed("names no objects"))?;
        for object in batch {
            let place = places.iter().find(|place| place["oid"] == object.oid);
            let place = place.ok_or_else(|| answer.malformed("lacks an object"))?;
            if let Some(problem) = place["error"]["message"].as_str() {
                return Err(failed(object, problem));
            }
            if place["actions"]["upload"].is_object() {
                progress.message(&object.file.path);
                upload(hub, object, &place["actions"])?;
                count += 1;
                bytes += object.size;
            }
            progress.advance(1);
        }
    }
    Ok((count, bytes))
}

/// Uploads an object to the address that the server names, in one piece or in parts.
fn upload(hub: &Hub, object: &Object<'_>, actions: &Value) -> Result<(), Error> {
    let (size, upload) = (object.size, &actions["upload"]);
    let place = upload["href"].as_str();
    let place = hub.here(place.ok_or_else(|| failed(object, "the server names no place"))?);
    let mut content = object.file.content.open()?;
    match &upload["header"]["chunk_size"] {
        Value::Null => {
            hub.put(&place, &mut content, size)
                .map_err(|problem| failed(object, &problem))?;
        }
        chunk => {
            let mut parts = Vec::new();
            for (number, (part, len)) in parts_of(object, &upload["header"], chunk)?
                .into_iter()
                .enumerate()
            {
                let sent = hub.put(part, &mut content, len);
                let headers = sent.map_err(|problem| failed(object, &problem))?;
                let etag = text_of(&headers, "etag")
                    .ok_or_else(|| failed(object, "the storage names no ETag of a part"))?;
                parts.push(json!({ "partNumber": number + 1, "etag": etag }));
            }
            let done = json!({ "oid": object.oid, "parts": parts });
            hub.post(&place, LFS, done.to_string().as_bytes())?
                .checked()?;
        }
    }
    if let Some(address) = actions["verify"]["href"].as_str() {
        let sent = json!({ "oid": object.oid, "size": size });
        hub.post(&hub.here(address), JSON, sent.to_string().as_bytes())?
            .checked()?;
    }
    Ok(())
}

/// Upload addresses of an object's parts in order, each with its length. `header` holds them by part number.
fn parts_of<'a>(
    object: &Object<'_>,
    header: &'a Value,
    chunk: &Value,
) -> Result<Vec<(&'a str, u64)>, Error> {
    let malformed = || failed(object, "the server names the places of its parts wrongly");
    let chunk = chunk
        .as_u64()
        .or_else(|| chunk.as_str()?.parse().ok())
        .filter(|chunk| *chunk > 0)
        .ok_or_else(malformed)?;
    let fields = header.as_object().ok_or_else(malformed)?;
    let mut places: Vec<(u64, &str)> = fields
        .iter()
        .filter_map(|(number, place)| Some((number.parse().ok()?, place.as_str()?)))
        .collect();
    places.sort_unstable();
    if places.len() as u64 != object.size.div_ceil(chunk) {
        return Err(malformed());
    }
    let of_part = |(index, (_, place)): (u64, (u64, &'a str))| {
        (place, chunk.min(object.size - index * chunk))
    };
    Ok((0..).zip(places).map(of_part).collect())
}

fn failed(object: &Object<'_>, problem: &str) -> Error {
    Error::upload(&object.file.path, problem)
}
