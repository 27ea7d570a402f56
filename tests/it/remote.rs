//! Sources at URLs through the command, served by this test.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;

use datasets_spec::record::MotionRow;

use crate::archives::{files_below, packed};
use crate::util::{Ran, arg, command, corpus, rows_of, stance};

/// Files by path.
type Files = BTreeMap<String, Vec<u8>>;

/// Error response of an object store for a missing bucket.
const NO_BUCKET: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Error><Code>NoSuchBucket</Code><Message>The \
                         specified bucket does not exist</Message><BucketName>missing</BucketName></Error>";

/// Serves files on a port of this machine as long as the test runs; requests for other paths get the error of a missing
/// bucket.
fn serve(files: Files) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let files = Arc::new(files);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let files = Arc::clone(&files);
            std::thread::spawn(move || answer(stream, &files));
        }
    });
    format!("http://{address}")
}

/// Answers requests on a connection until it is closed.
fn answer(stream: TcpStream, files: &Files) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut stream = stream;
    loop {
        let mut request = String::new();
        if reader.read_line(&mut request)? == 0 {
            return Ok(());
        }
        let (mut range, mut length) = (None, 0u64);
        loop {
            let mut line = String::new();
            reader.read_line(&mut line)?;
            let line = line.trim().to_lowercase();
            if line.is_empty() {
                break;
            }
            if let Some(bytes) = line.strip_prefix("range: bytes=") {
                range = Some(bytes.to_owned());
            }
            if let Some(bytes) = line.strip_prefix("content-length: ") {
                length = bytes.parse().unwrap_or(0);
            }
        }
        std::io::copy(&mut (&mut reader).take(length), &mut std::io::sink())?;
        let mut words = request.split_whitespace();
        let (method, path) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
        let path = path.split('?').next().unwrap_or("").trim_start_matches('/');
        let date = "last-modified: Mon, 01 Jan 2024 00:00:00 GMT\r\netag: \"1\"\r\n";
        let (status, head, body) = match (files.get(path), range) {
            (None, _) => ("404 Not Found", String::new(), NO_BUCKET.as_bytes()),
            (Some(bytes), None) => ("200 OK", date.to_owned(), &bytes[..]),
            (Some(bytes), Some(range)) => {
                let (start, end) = range.split_once('-').unwrap_or(("0", ""));
                let start: usize = start.parse().unwrap_or(0);
                let last = end.parse().unwrap_or(usize::MAX).min(bytes.len() - 1);
                let range = format!("content-range: bytes {start}-{last}/{}\r\n", bytes.len());
                (
                    "206 Partial Content",
                    format!("{date}{range}"),
                    &bytes[start..=last],
                )
            }
        };
        let head = format!(
            "HTTP/1.1 {status}\r\ncontent-length: {}\r\n{head}\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes())?;
        if method != "HEAD" {
            stream.write_all(body)?;
        }
    }
}

#[test]
fn a_missing_bucket_is_a_sentence() {
    let endpoint = serve(Files::new());
    let dir = corpus(2);
    let out = dir.path().join("dataset");
    let ran: Ran = command(&["ingest", "s3://missing/clips", "--out", arg(&out)])
        .env("AWS_ENDPOINT_URL", &endpoint)
        .env("AWS_ACCESS_KEY_ID", "key")
        .env("AWS_SECRET_ACCESS_KEY", "secret")
        .env("AWS_REGION", "us-east-1")
        .output()
        .expect("starts")
        .into();
    let ran = ran.expect_code(1);
    ran.expect_said("there is no bucket missing");
    assert!(!ran.stderr.contains('<'), "{}", ran.stderr);
}

#[test]
fn archives_at_urls_are_read() {
    let dir = corpus(4);
    let files = files_below(&dir.path().join("corpus"));
    let archives = ["all.zip", "all.tar", "all.tar.gz"];
    let served = archives.map(|name| (format!("data/{name}"), packed(name, &files)));
    let server = serve(served.into());
    let clips = |source: &str, out: &str, prefix: &str| -> BTreeMap<String, String> {
        let out = dir.path().join(out);
        let ran: Ran = command(&["ingest", source, "--out", arg(&out)])
            .env("AWS_ENDPOINT_URL", &server)
            .env("AWS_ACCESS_KEY_ID", "key")
            .env("AWS_SECRET_ACCESS_KEY", "secret")
            .env("AWS_REGION", "us-east-1")
            .output()
            .expect("starts")
            .into();
        ran.expect_code(0);
        let rows: Vec<MotionRow> = rows_of(&out);
        let clips = rows.into_iter().map(|row| {
            let id = row.id.to_string();
            let id = id.strip_prefix(prefix).unwrap_or_else(|| panic!("{id}"));
            (id.to_owned(), row.content_hash)
        });
        clips.collect()
    };
    let plain = dir.path().join("corpus");
    let expected = clips(arg(&plain), "plain", "");
    fs::create_dir_all(dir.path().join("tmp")).expect("made");
    for name in archives {
        let found = clips(&format!("{server}/data/{name}"), name, &format!("{name}/"));
        assert_eq!(found, expected, "{name}");
        let found = clips(
            &format!("s3://data/{name}"),
            &format!("s3-{name}"),
            &format!("{name}/"),
        );
        assert_eq!(found, expected, "{name} in a bucket");
    }
}

#[test]
fn a_source_at_a_url_has_the_name_that_it_is_given() {
    let dir = corpus(4);
    let packed = packed("all.zip", &files_below(&dir.path().join("corpus")));
    let files =
        ["anna/bvh/all.zip", "ben/bvh/all.zip"].map(|path| (path.to_owned(), packed.clone()));
    let server = serve(files.into());
    let out = dir.path().join("dataset");
    let ingest = |sources: &[String], code: i32| -> Ran {
        let sources: Vec<&str> = sources.iter().map(String::as_str).collect();
        let ran = stance(&[&["ingest"], &sources[..], &["--out", arg(&out)]].concat());
        ran.expect_code(code)
    };
    let at = |folder: &str| format!("{server}/{folder}/bvh/all.zip");
    let named = |name: &str, folder: &str| format!("{name}={}", at(folder));
    let names = || -> BTreeMap<String, usize> {
        let rows: Vec<MotionRow> = rows_of(&out);
        let mut names = BTreeMap::new();
        for row in rows {
            *names.entry(row.source_name).or_default() += 1;
        }
        names
    };
    ingest(&[at("anna")], 0);
    let alone = names();
    assert_eq!(alone.keys().collect::<Vec<_>>(), ["bvh"]);
    // The same name at another URL is ambiguous, so the user is asked.
    let said = ingest(&[at("ben")], 2).stderr;
    assert!(said.contains(&format!("ben-bvh={}", at("ben"))), "{said}");
    assert_eq!(names(), alone);
    ingest(&[named("ben", "ben")], 0);
    assert_eq!(names()["ben"], alone["bvh"]);
    // The source is recognised by its URL alone.
    let again = ingest(&[at("ben")], 0);
    again.expect_printed("already complete");
}
