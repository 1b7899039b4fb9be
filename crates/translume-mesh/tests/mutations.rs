//! Damaged files: bytes changed, cut, doubled and moved by a seeded generator. Every result is a sound mesh or an error,
//! never a panic, and never much larger than the file.

mod common;

use common::*;
use std::path::Path;
use translume_core::rng::Pcg32;
use translume_mesh::{Format, Loaded, Result, gltf, obj, off, ply, serialized, stl};

/// Every format, named by the extension that a file of it has.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = wave();
    let mut little = Vec::new();
    ply::write(&mesh, &mut little).unwrap();
    let mut text = Vec::new();
    obj::write(&mesh, &mut text).unwrap();
    vec![
        ("ply", little),
        ("ply", ply_text(&mesh).into_bytes()),
        ("ply", ply_big(&mesh)),
        ("ply", ply_strips()),
        ("obj", [&b"mtllib a b.mtl\no wave\nusemtl red\n"[..], &text].concat()),
        ("obj", b"v 0 0 0\nv 2 0 0\nv 2 2 0\nv .5 .5 0\nv 0 2 0\nf -5 -4 -3 \\\n -2 -1\n".to_vec()),
        ("glb", glb(&mesh)),
        ("gltf", gltf_text(&mesh)),
        ("stl", {
            let mut bytes = Vec::new();
            stl::write(&mesh, &mut bytes).unwrap();
            bytes
        }),
        ("stl", b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n".to_vec()),
        ("off", b"COFF\n3 1 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n0 1 0 0 0 255 255\n3 0 1 2 9\n".to_vec()),
        ("serialized", serialized(&mesh, 4, false)),
        ("serialized", serialized(&mesh, 3, true)),
    ]
}

/// The readers by format, without the file system.
fn parse(extension: &str, bytes: Vec<u8>) -> Result<Loaded> {
    let path = Path::new("/nonexistent/x").with_extension(extension);
    match Format::detect(&path, &bytes) {
        Some(Format::Ply) => ply::read(&path, &bytes),
        Some(Format::Obj) => obj::read(&path, &bytes),
        Some(Format::Gltf) => gltf::Asset::from_bytes(&path, bytes)?.flatten(),
        Some(Format::Stl) => stl::read(&path, &bytes),
        Some(Format::Off) => off::read(&path, &bytes),
        Some(Format::Serialized) => serialized::read(&path, &bytes, None),
        None => panic!("the extension tells the format"),
    }
}

fn mutate(bytes: &mut Vec<u8>, rng: &mut Pcg32) {
    const ODD: [&[u8]; 12] = [
        b"-1",
        b"4294967295",
        b"18446744073709551616",
        b"nan",
        b"1e999",
        b"\0",
        b"\n",
        b"[",
        b"}",
        b"\"",
        &[0xff; 4],
        &[0x7f, 0xff, 0xff, 0xff],
    ];
    let below = |n: usize, rng: &mut Pcg32| rng.next_u32() as usize % n.max(1);
    for _ in 0..1 + below(4, rng) {
        let at = below(bytes.len(), rng);
        match below(8, rng) {
            _ if bytes.is_empty() => return,
            0 => bytes[at] ^= 1 << below(8, rng),
            1 => bytes[at] = rng.next_u32() as u8,
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..(at + 1 + below(16, rng)).min(bytes.len()))),
            4 => {
                let copy = bytes[at..(at + 1 + below(64, rng)).min(bytes.len())].to_vec();
                let to = below(bytes.len(), rng);
                drop(bytes.splice(to..to, copy));
            }
            5 => drop(bytes.splice(at..at, ODD[below(ODD.len(), rng)].iter().copied())),
            // A number in text becomes another one.
            6 => {
                if let Some(digit) = bytes[at..].iter().position(u8::is_ascii_digit) {
                    let to = ODD[below(5, rng)];
                    drop(bytes.splice(at + digit..at + digit + 1, to.iter().copied()));
                }
            }
            _ => {
                let n = 8.min(bytes.len() - at);
                bytes[at..at + n].fill(if below(2, rng) == 0 { 0 } else { 0xff });
            }
        }
    }
}

/// Reads mutants of `samples`; `wrap` makes a file of the mutated bytes.
fn bombard(extension: &str, samples: &[Vec<u8>], rounds: u64, wrap: impl Fn(usize, Vec<u8>) -> Vec<u8>) {
    let (mut read, mut refused) = (0, 0);
    for (s, sample) in samples.iter().enumerate() {
        assert!(parse(extension, wrap(s, sample.clone())).is_ok_and(|l| !l.parts.is_empty()), "sample {s} itself");
        for round in 0..rounds {
            let mut bytes = sample.clone();
            mutate(&mut bytes, &mut Pcg32::new(round, s as u64));
            let bytes = wrap(s, bytes);
            let size = bytes.len();
            match parse(extension, bytes) {
                Ok(loaded) => {
                    read += 1;
                    for part in &loaded.parts {
                        assert_eq!(part.mesh.fault(), None, "sample {s} round {round}");
                        let held = part.mesh.positions.len() + part.mesh.indices.len();
                        assert!(held < 1100 * (size + 100), "sample {s} round {round}: {held} of {size} bytes");
                    }
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().contains('\n'), "{error}");
                }
            }
        }
    }
    eprintln!("{extension}: {read} read, {refused} refused");
    assert!(read > 0 && refused > 0);
}

fn of_format(which: &str) -> Vec<Vec<u8>> {
    samples().into_iter().filter(|(extension, _)| *extension == which).map(|(_, bytes)| bytes).collect()
}

#[test]
fn ply_survives() {
    bombard("ply", &of_format("ply"), 10_000, |_, bytes| bytes);
}

#[test]
fn obj_survives() {
    bombard("obj", &of_format("obj"), 10_000, |_, bytes| bytes);
}

#[test]
fn glb_survives() {
    bombard("glb", &of_format("glb"), 10_000, |_, bytes| bytes);
}

#[test]
fn gltf_survives() {
    bombard("gltf", &of_format("gltf"), 10_000, |_, bytes| bytes);
}

#[test]
fn stl_and_off_survive() {
    bombard("stl", &of_format("stl"), 10_000, |_, bytes| bytes);
    bombard("off", &of_format("off"), 10_000, |_, bytes| bytes);
}

#[test]
fn serialized_survives() {
    bombard("serialized", &of_format("serialized"), 10_000, |_, bytes| bytes);
}

/// Damage that the compression's checksum does not see.
#[test]
fn serialized_streams_survive() {
    let streams = [stream(&wave(), 0xb, 4, false), stream(&wave(), 0xb, 4, true)];
    bombard("serialized", &streams, 5_000, |_, raw| serialized_from(4, &[raw]));
}
