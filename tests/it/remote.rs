//! Sources at URLs through the command, served by this test.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::record::MotionRow;

use crate::archives::{Files, files_below, packed};
use crate::hub::server::{Reply, serve};
use crate::util::{Folder, Ran, arg, command, motions_of};

/// Error response of an object store for a missing bucket.
const NO_BUCKET: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Error><Code>NoSuchBucket</Code><Message>The \
                         specified bucket does not exist</Message><BucketName>missing</BucketName></Error>";

/// Serves files on a port of this machine as long as the test runs; requests for other paths get the error of a missing
/// bucket.
fn serve_files(files: Files) -> String {
    serve(move |request| {
        let path = request.target.split('?').next().unwrap_or_default();
        let date = "last-modified: Mon, 01 Jan 2024 00:00:00 GMT\r\netag: \"1\"\r\n".to_owned();
        let file = files.get(path.trim_start_matches('/'));
        let (mut reply, header) = match (file, &request.range) {
            (None, _) => (Reply::new("404 Not Found", NO_BUCKET), String::new()),
            (Some(bytes), None) => (Reply::new("200 OK", &bytes[..]), date),
            (Some(bytes), Some(range)) => {
                let (start, end) = range.split_once('-').unwrap_or(("0", ""));
                let start: usize = start.parse().unwrap_or(0);
                let last = end.parse().unwrap_or(usize::MAX).min(bytes.len() - 1);
                let range = format!("content-range: bytes {start}-{last}/{}\r\n", bytes.len());
                let part = Reply::new("206 Partial Content", &bytes[start..=last]);
                (part, date + &range)
            }
        };
        reply.header = header;
        if request.method == "HEAD" {
            reply.cut = 0;
        }
        Some(reply)
    })
}

/// Ingests a source; buckets are looked up at `endpoint`.
fn ingest(endpoint: &str, source: &str, out: &Path) -> Ran {
    command(&["ingest", source, "--out", arg(out)])
        .env("AWS_ENDPOINT_URL", endpoint)
        .env("AWS_ACCESS_KEY_ID", "key")
        .env("AWS_SECRET_ACCESS_KEY", "secret")
        .env("AWS_REGION", "us-east-1")
        .output()
        .expect("starts")
        .into()
}

#[test]
fn archives_at_urls_are_read_and_a_missing_bucket_is_a_sentence() {
    let dir = Folder::of_clips(4);
    let files = files_below(&dir.path("corpus"));
    let archives = ["all.zip", "all.tar", "all.tar.gz"];
    let served = archives.map(|name| (format!("data/{name}"), packed(name, &files)));
    let server = serve_files(served.into());
    let clips = |source: &str, out: &str, prefix: &str| -> BTreeMap<String, String> {
        let out = dir.path(out);
        ingest(&server, source, &out).expect_code(0);
        let clips = motions_of(&out).into_iter().map(|(id, row)| {
            let id = id.strip_prefix(prefix).unwrap_or_else(|| panic!("{id}"));
            (id.to_owned(), row.content_hash)
        });
        clips.collect()
    };
    let plain = dir.path("corpus");
    let expected = clips(arg(&plain), "plain", "");
    for name in archives {
        let found = clips(&format!("{server}/data/{name}"), name, &format!("{name}/"));
        assert_eq!(found, expected, "{name}");
        let (url, out) = (format!("s3://data/{name}"), format!("s3-{name}"));
        let found = clips(&url, &out, &format!("{name}/"));
        assert_eq!(found, expected, "{name} in a bucket");
    }
    let missing = ingest(&server, "s3://missing/clips", &dir.path("none"));
    let said = missing.refusal();
    let is_sentence = said.contains("there is no bucket missing") && !said.contains('<');
    assert!(is_sentence, "{said}");
}

#[test]
fn a_source_at_a_url_has_the_name_that_it_is_given() {
    let dir = Folder::of_clips(4);
    let packed = packed("all.zip", &files_below(&dir.path("corpus")));
    let files =
        ["anna/bvh/all.zip", "ben/bvh/all.zip"].map(|path| (path.to_owned(), packed.clone()));
    let server = serve_files(files.into());
    let ingest = |source: String, code: i32| -> Ran {
        let ran = dir.typed(&format!("ingest --out @dataset {source}"));
        ran.expect_code(code)
    };
    let at = |folder: &str| format!("{server}/{folder}/bvh/all.zip");
    let named = |name: &str, folder: &str| format!("{name}={}", at(folder));
    let names = || -> BTreeMap<String, usize> {
        let mut names = BTreeMap::new();
        for row in dir.rows::<MotionRow>("dataset") {
            *names.entry(row.source_name).or_default() += 1;
        }
        names
    };
    ingest(at("anna"), 0);
    let alone = names();
    assert_eq!(alone.keys().collect::<Vec<_>>(), ["bvh"]);
    // The same name at another URL is ambiguous, so the user is asked.
    let said = ingest(at("ben"), 2).stderr;
    assert!(said.contains(&format!("ben-bvh={}", at("ben"))), "{said}");
    assert_eq!(names(), alone);
    ingest(named("ben", "ben"), 0);
    assert_eq!(names()["ben"], alone["bvh"]);
    // The source is recognised by its URL alone.
    let again = ingest(at("ben"), 0);
    again.expect_printed("already complete");
}
