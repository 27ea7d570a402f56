//! The address of a client behind proxies.
//!
//! Every proxy appends the address of its caller to `X-Forwarded-For` or `Forwarded`. A client may send such headers
//! itself, so the list is read from its end, and only as far as trusted proxies wrote it.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::str::FromStr;

use axum::http::header::{FORWARDED, HeaderMap, HeaderName};
use ipnet::IpNet;

/// A proxy: its address, or the network it is in, such as `10.0.0.0/8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrustedProxy(IpNet);

impl FromStr for TrustedProxy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<IpAddr>()
            .map(IpNet::from)
            .or_else(|_| text.parse())
            .map(Self)
            .map_err(|_| {
                "write an address such as 127.0.0.1, or a network such as 10.0.0.0/8".to_owned()
            })
    }
}

const X_FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// Address of the client of a request that came from `peer`.
pub(super) fn client(peer: IpAddr, headers: &HeaderMap, trusted: &[TrustedProxy]) -> IpAddr {
    let peer = peer.to_canonical();
    let is_trusted = |address: IpAddr| trusted.iter().any(|proxy| proxy.0.contains(&address));
    if !is_trusted(peer) {
        return peer;
    }
    let outermost = |hops: Vec<Option<IpAddr>>| {
        let mut known = peer;
        for hop in hops.into_iter().rev() {
            match hop {
                Some(address) if is_trusted(address) => known = address,
                Some(address) => return address,
                // An entry without an address: no trusted proxy confirms the entries before it.
                None => return known,
            }
        }
        known
    };
    let by_list = outermost(hops(headers, &X_FORWARDED_FOR, address));
    let by_fields = outermost(hops(headers, &FORWARDED, forwarded_for));
    // A proxy that writes one of the headers forwards the client's version of the other one, so both must agree.
    match (
        headers.contains_key(X_FORWARDED_FOR),
        headers.contains_key(FORWARDED),
    ) {
        (true, true) if by_list != by_fields => peer,
        (_, true) => by_fields,
        _ => by_list,
    }
}

/// Rate-limit key of a client: its IPv4 address, or its IPv6 /64 network, because one host may use all of that network.
pub(super) fn counted(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => {
            Ipv6Addr::from_bits(address.to_bits() & (u128::MAX << u64::BITS)).into()
        }
    }
}

/// The addresses of a header that holds lists, in order; `None` for an entry without an address.
fn hops(
    headers: &HeaderMap,
    name: &HeaderName,
    read: fn(&str) -> Option<IpAddr>,
) -> Vec<Option<IpAddr>> {
    headers
        .get_all(name)
        .iter()
        .flat_map(|value| match value.to_str() {
            Ok(text) => split(text, ',').map(read).collect(),
            Err(_) => vec![None],
        })
        .collect()
}

/// The address in `for=…` of an element of `Forwarded` (RFC 7239).
fn forwarded_for(element: &str) -> Option<IpAddr> {
    split(element, ';')
        .filter_map(|pair| pair.split_once('='))
        .find(|(name, _)| name.trim().eq_ignore_ascii_case("for"))
        .and_then(|(_, value)| address(value.trim().trim_matches('"')))
}

/// An address with or without a port; IPv6 addresses may be in brackets.
fn address(text: &str) -> Option<IpAddr> {
    let text = text.trim();
    let with_port = text.parse().map(|address: SocketAddr| address.ip());
    let bracketed = text
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'));
    let address = with_port.or_else(|_| bracketed.unwrap_or(text).parse::<IpAddr>());
    address.ok().map(|address| address.to_canonical())
}

/// Splits at separators outside of quotes.
fn split(text: &str, separator: char) -> impl Iterator<Item = &str> {
    let mut is_quoted = false;
    text.split(move |c| {
        is_quoted ^= c == '"';
        c == separator && !is_quoted
    })
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    /// The client of a request from 10.0.0.1, where 10.0.0.0/24 and fd00::1 are trusted.
    fn client_of(headers: &[(&'static str, &str)]) -> String {
        let trusted = ["10.0.0.0/24", "fd00::1"].map(|net| net.parse().expect("a net"));
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            let value = HeaderValue::from_str(value).expect("a value");
            map.append(HeaderName::from_static(name), value);
        }
        client(IpAddr::from([10, 0, 0, 1]), &map, &trusted).to_string()
    }

    #[test]
    fn the_last_address_that_no_trusted_proxy_has_is_the_client() {
        assert_eq!(client_of(&[]), "10.0.0.1");
        for (list, expected) in [
            ("192.0.2.7", "192.0.2.7"),
            ("192.0.2.7:4711", "192.0.2.7"),
            ("[2001:db8::7]:4711", "2001:db8::7"),
            ("::ffff:192.0.2.7", "192.0.2.7"),
            ("[2001:db8::7]", "2001:db8::7"),
            ("[2001:db8::7", "10.0.0.1"),
            // Addresses that the client sent itself precede its real address.
            ("127.0.0.1, 192.0.2.7", "192.0.2.7"),
            ("1.2.3.4, 192.0.2.7, 10.0.0.9, fd00::1", "192.0.2.7"),
            ("192.0.2.7, unknown", "10.0.0.1"),
            ("192.0.2.7, x, 10.0.0.9", "10.0.0.9"),
            ("10.0.0.8", "10.0.0.8"),
        ] {
            assert_eq!(client_of(&[("x-forwarded-for", list)]), expected, "{list}");
        }
        let lists = ["1.2.3.4", "192.0.2.7"].map(|list| ("x-forwarded-for", list));
        assert_eq!(client_of(&lists), "192.0.2.7");
        let quoted = "for=1.2.3.4, for=\"[2001:db8::7]:80\";proto=https, For=10.0.0.9";
        for (fields, expected) in [
            (quoted, "2001:db8::7"),
            ("for=\"a,b;c\", for=192.0.2.7", "192.0.2.7"),
            ("for=192.0.2.7, for=_hidden", "10.0.0.1"),
            ("for=192.0.2.7, by=10.0.0.9", "10.0.0.1"),
        ] {
            assert_eq!(client_of(&[("forwarded", fields)]), expected, "{fields}");
        }
    }

    #[test]
    fn headers_that_differ_and_those_of_others_are_ignored_and_a_network_is_counted_once() {
        let both = |list, fields| client_of(&[("x-forwarded-for", list), ("forwarded", fields)]);
        assert_eq!(both("192.0.2.7", "for=192.0.2.7"), "192.0.2.7");
        assert_eq!(both("192.0.2.7", "for=1.2.3.4"), "10.0.0.1");
        let mut headers = HeaderMap::new();
        headers.insert(X_FORWARDED_FOR, HeaderValue::from_static("192.0.2.7"));
        let peer = IpAddr::from([198, 51, 100, 1]);
        assert_eq!(client(peer, &headers, &[]), peer);
        let trusted = ["10.0.0.0/24".parse().expect("a net")];
        assert_eq!(client(peer, &headers, &trusted), peer);
        let of = |text: &str| counted(text.parse().expect("an address")).to_string();
        assert_eq!(of("2001:db8:1:2:3:4:5:6"), "2001:db8:1:2::");
        assert_eq!(of("::ffff:192.0.2.7"), "192.0.2.7");
    }
}
