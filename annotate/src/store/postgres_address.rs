//! Addresses of PostgreSQL, with TLS.

use std::sync::Arc;

use form_urlencoded::parse;
use postgres::config::{Host, SslMode};
use postgres::{Client, Config};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::db::{Result, not_opened};
use crate::Error;

/// An error for an address that cannot be used.
fn refused(reason: impl std::fmt::Display) -> Error {
    not_opened("on PostgreSQL", reason)
}

/// The address of a PostgreSQL database, with its TLS settings.
pub(super) struct Address {
    config: Config,
    tls: MakeRustlsConnect,
}

impl Address {
    /// Parses an address `postgres://USER@HOST/DATABASE?…`, whose parameters are those of PostgreSQL's own programs.
    /// Unless `sslmode` says otherwise, a connection to another host is encrypted and the server's certificate checked.
    pub(super) fn parse(url: &str) -> Result<Self> {
        let (mut plain, parameters) = match url.rfind('?') {
            Some(at) if url.rfind('@').is_none_or(|host| host < at) => {
                (url[..at].to_owned(), &url[at + 1..])
            }
            _ => (url.to_owned(), ""),
        };
        let (mut mode, mut authorities) = (None, None);
        // The driver's URL parser knows neither certificate authorities nor all TLS modes, so both are read here.
        for parameter in parameters.split('&').filter(|text| !text.is_empty()) {
            match parse(parameter.as_bytes()).next() {
                Some((name, value)) if name == "sslmode" => mode = Some(ssl_mode(&value).ok_or_else(|| {
                    refused(format!(
                        "its address has sslmode={value}; use disable, prefer, require or verify-full"
                    ))
                })?),
                Some((name, value)) if name == "sslrootcert" => authorities = Some(value.into_owned()),
                _ => {
                    plain.push(if plain.contains('?') { '&' } else { '?' });
                    plain.push_str(parameter);
                }
            }
        }
        let mut config: Config = plain
            .parse()
            .map_err(|error| refused(format!("its address cannot be read: {}", causes(&error))))?;
        let mode = mode.unwrap_or(if config.get_hosts().iter().all(is_local) {
            SslMode::Disable
        } else {
            SslMode::Require
        });
        config.ssl_mode(mode);
        let tls = MakeRustlsConnect::new(tls(authorities.as_deref())?);
        Ok(Self { config, tls })
    }

    /// The address without user and password, for messages.
    pub(super) fn place(&self) -> String {
        let hosts: Vec<String> = self
            .config
            .get_hosts()
            .iter()
            .map(|host| match host {
                Host::Tcp(name) => name.clone(),
                #[cfg(unix)]
                Host::Unix(folder) => folder.display().to_string(),
            })
            .collect();
        let database = self.config.get_dbname().unwrap_or("postgres");
        format!("{}/{database}", hosts.join(","))
    }

    pub(super) fn connect(&self) -> Result<Client> {
        self.config
            .connect(self.tls.clone())
            .map_err(|error| not_opened(self.place(), self.advice(&causes(&error))))
    }

    /// The error message for a failed connection, with advice.
    fn advice(&self, causes: &str) -> String {
        let advice = if causes.contains("does not support TLS") {
            "; switch TLS on at the server, or add sslmode=disable to the address if nobody can listen on the way"
        } else if causes.contains("UnknownIssuer") {
            "; add sslrootcert=FILE to the address, with the certificate of the authority that signed the server's"
        } else if causes.contains("NotValidForName") || causes.contains("not valid for name") {
            "; name the host as the certificate of the server does"
        } else {
            ""
        };
        format!("{causes}{advice}")
    }
}

fn ssl_mode(text: &str) -> Option<SslMode> {
    match text {
        "disable" => Some(SslMode::Disable),
        "prefer" => Some(SslMode::Prefer),
        // Other clients do not check the certificate with `require`; this one always does.
        "require" | "verify-full" => Some(SslMode::Require),
        _ => None,
    }
}

/// Whether a connection stays on this machine.
fn is_local(host: &Host) -> bool {
    match host {
        Host::Tcp(name) => {
            let name = name.trim_start_matches('[').trim_end_matches(']');
            name == "localhost"
                || name
                    .parse::<std::net::IpAddr>()
                    .is_ok_and(|address| address.is_loopback())
        }
        #[cfg(unix)]
        Host::Unix(_) => true,
    }
}

/// TLS settings that trust the certificate authorities in a file, or by default those that browsers trust.
fn tls(authorities: Option<&str>) -> Result<ClientConfig> {
    let mut roots = RootCertStore::empty();
    match authorities {
        None => roots.extend(webpki_roots::TLS_SERVER_ROOTS.iter().cloned()),
        Some(file) => {
            let unreadable = |problem: &dyn std::fmt::Display| {
                refused(format!(
                    "cannot read the certificates of sslrootcert={file}: {problem}"
                ))
            };
            let found = CertificateDer::pem_file_iter(file).map_err(|error| unreadable(&error))?;
            for certificate in found {
                let certificate = certificate.map_err(|error| unreadable(&error))?;
                roots.add(certificate).map_err(|error| unreadable(&error))?;
            }
            if roots.is_empty() {
                return Err(unreadable(&"it holds none"));
            }
        }
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(refused)?;
    Ok(builder.with_root_certificates(roots).with_no_client_auth())
}

/// An error with its causes.
fn causes(error: &postgres::Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        // Some errors repeat their cause.
        let more = error.to_string();
        if !text.contains(&more) {
            text += &format!(": {more}");
        }
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(url: &str) -> SslMode {
        Address::parse(url)
            .expect("an address")
            .config
            .get_ssl_mode()
    }

    #[test]
    fn a_connection_to_another_host_is_encrypted_unless_the_address_says_otherwise() {
        let encrypted = [
            "ann@db.example/stance",
            "ann@10.0.0.5/stance?connect_timeout=3",
            "ann@localhost,db.example/stance",
            "ann@localhost/stance?sslmode=verify-full",
            "ann:a%3Fb@localhost/stance?sslmode=require&connect_timeout=3",
        ];
        let plain = [
            "ann@localhost/stance",
            "ann@127.0.0.1:5433/stance",
            "ann@%2Frun%2Fpostgresql/stance",
            "/stance?host=/run/postgresql",
            "ann@db.example/stance?sslmode=disable",
        ];
        let encrypted = encrypted.map(|url| (url, SslMode::Require));
        let plain = plain.map(|url| (url, SslMode::Disable));
        let either = [("ann@db.example/stance?sslmode=prefer", SslMode::Prefer)];
        for (url, expected) in encrypted.into_iter().chain(plain).chain(either) {
            let url = &format!("postgres://{url}");
            assert_eq!(mode(url), expected, "{url}");
        }
    }

    #[test]
    fn an_address_that_cannot_be_kept_to_is_refused() {
        for (url, part) in [
            ("postgres://db.example/x?sslmode=verify-ca", "verify-full"),
            (
                "postgres://db.example/x?sslrootcert=/nowhere/ca.pem",
                "/nowhere/ca.pem",
            ),
            ("postgres://db.example/x?colour=red", "colour"),
        ] {
            let Err(error) = Address::parse(url) else {
                panic!("{url} is taken");
            };
            assert!(error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn messages_name_the_place_without_the_password() {
        let address = Address::parse("postgres://ann:secret@db.example/stance?password=secret2")
            .expect("an address");
        assert_eq!(address.place(), "db.example/stance");
    }
}
