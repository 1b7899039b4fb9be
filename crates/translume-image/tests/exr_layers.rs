//! Which channels of OpenEXR files make the picture, and what half floats and Radiance's codes cannot hold.

mod support;

use std::path::{Path, PathBuf};
use support::warnings;
use translume_image::*;

const SIZE: (usize, usize) = (3, 2);

/// A file with these channels; channel i holds i + 1 everywhere.
fn file(dir: &Path, names: &[&str]) -> PathBuf {
    let path = dir.join("a.exr");
    let planes: Vec<Vec<f32>> = (0..names.len()).map(|i| vec![i as f32 + 1.0; 6]).collect();
    let channels: Vec<(&str, &[f32])> = names.iter().zip(&planes).map(|(n, p)| (*n, p.as_slice())).collect();
    write_exr_channels(&path, SIZE, &channels, &ExrOptions::default()).unwrap();
    path
}

/// The first pixel, with the warnings.
fn first(path: &Path) -> ([f32; 3], Vec<String>) {
    let (picture, said) = warnings(|| read_picture(path).unwrap());
    (picture.pixels.get_pixel(0, 0).0, said)
}

#[test]
fn colour_is_found_by_its_names() {
    let dir = tempfile::tempdir().unwrap();
    let cases: &[(&[&str], [f32; 3])] = &[
        (&["R", "G", "B"], [1.0, 2.0, 3.0]),
        (&["r", "g", "b"], [1.0, 2.0, 3.0]),
        (&["red", "green", "blue"], [1.0, 2.0, 3.0]),
        (&["Red", "Green", "Blue", "Alpha"], [1.0, 2.0, 3.0]),
        (&["Y"], [1.0; 3]),
        (&["Y", "A"], [1.0; 3]),
        (&["depth"], [1.0; 3]),
        // A Y beside X or Z is a coordinate.
        (&["normal.X", "normal.Y", "normal.Z", "noisy.R", "noisy.G", "noisy.B"], [4.0, 5.0, 6.0]),
        (&["N.Y", "N.Z", "albedo.R", "albedo.G", "albedo.B"], [3.0, 4.0, 5.0]),
        (&["Z", "X", "Y", "albedo.Y"], [4.0; 3]),
        // The picture itself before its layers, the whole before its parts.
        (&["albedo.R", "albedo.G", "albedo.B", "R", "G", "B"], [4.0, 5.0, 6.0]),
        (&["V.Albedo.R", "V.Albedo.G", "V.Albedo.B", "V.Combined.R", "V.Combined.G", "V.Combined.B"], [4.0, 5.0, 6.0]),
    ];
    for (names, wanted) in cases {
        assert_eq!(first(&file(dir.path(), names)), (*wanted, vec![]), "{names:?}");
    }
}

#[test]
fn what_is_missing_or_ambiguous_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let cases: &[(&[&str], [f32; 3], &str)] = &[
        (&["R", "G"], [1.0, 2.0, 0.0], "no channel for blue"),
        (&["G", "B", "A"], [0.0, 1.0, 2.0], "no channel for red"),
        (&["R", "A"], [1.0; 3], "gray"),
        (
            &["a.R", "a.G", "a.B", "b.R", "b.G", "b.B"],
            [1.0, 2.0, 3.0],
            "several layers hold a picture (a, b); 'a' is read",
        ),
    ];
    for (names, wanted, word) in cases {
        let (got, said) = first(&file(dir.path(), names));
        assert_eq!(got, *wanted, "{names:?}");
        assert!(said.len() == 1 && said[0].contains(word), "{said:?}");
    }
}

#[test]
fn numbers_that_are_no_colour_are_read_by_name_only() {
    let dir = tempfile::tempdir().unwrap();
    let path = file(dir.path(), &["normal.X", "normal.Y", "normal.Z", "depth.V"]);
    let error = read_picture(&path).unwrap_err();
    assert!(matches!(&error, Error::Layers { layers, .. } if layers == &["depth", "normal"]), "{error:?}");
    assert!(error.to_string().contains("name one of its layers: depth, normal"), "{error}");
    assert_eq!(read_layer(&path, "normal").unwrap().pixels.get_pixel(0, 0).0, [1.0, 2.0, 3.0]);
    assert_eq!(read_layer(&path, "depth").unwrap().pixels.get_pixel(0, 0).0, [4.0; 3]);
    assert!(read_picture(&file(dir.path(), &["X", "Y", "Z"])).is_err());
}

#[test]
fn a_deep_part_is_passed_over() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/flat-and-deep.exr");
    for read in [read_picture(&path), read_layer(&path, "beauty")] {
        let picture = read.unwrap();
        assert_eq!(picture.pixels.dimensions(), (6, 4));
        assert!((picture.pixels.get_pixel(3, 2)[0] - (0.1 + 3.0 / 16.0)).abs() < 1e-3);
    }
    let error = read_layer(&path, "depths").unwrap_err().to_string();
    assert!(error.contains("deep"), "{error}");
    assert_eq!(read_exr_channels(&path, 0).unwrap().planes.len(), 3);
    assert!(read_exr_channels(&path, 1).unwrap_err().to_string().contains("deep"));
}

#[test]
fn colours_that_radiance_files_cannot_hold_are_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.hdr");
    let write = |v: f32| {
        let picture = Picture::new(Rgb32FImage::from_pixel(2, 1, image::Rgb([1.0, v, 0.5])));
        warnings(|| write_hdr(&path, &picture).unwrap()).1
    };
    assert!(write(0.0).is_empty() && write(-0.001).is_empty(), "noise below the codes");
    let said = write(-0.04);
    assert!(said.len() == 1 && said[0].contains("2 pixels have negative components"), "{said:?}");
}

#[test]
fn values_beyond_half_floats_are_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.exr");
    let picture = |v: f32| Picture::new(Rgb32FImage::from_pixel(2, 1, image::Rgb([v, 1.0, f32::NAN])));
    let float = ExrOptions { precision: Precision::Float, ..ExrOptions::default() };
    let write = |v: f32, options: &ExrOptions| warnings(|| write_exr(&path, &picture(v), options).unwrap()).1;
    assert!(write(65504.0, &ExrOptions::default()).is_empty());
    assert!(write(1e6, &float).is_empty());
    let said = write(1e6, &ExrOptions::default());
    assert!(said.len() == 1 && said[0].contains("2 values (up to 1.0000e6) are beyond 65504"), "{said:?}");
    let planes = [("Z", [1e5f32, -1e5, 1.0].as_slice()), ("V", &[1.0; 3])];
    let (_, said) = warnings(|| write_exr_channels(&path, (3, 1), &planes, &ExrOptions::default()).unwrap());
    assert!(said.len() == 1 && said[0].contains("2 values of channel Z"), "{said:?}");
}
