//! Files that are no plain files, and pictures that are larger than is allowed. One test: the limit is the process's.

use std::path::Path;
use translume_image::*;

#[test]
fn the_limit_on_decoded_bytes_is_said_and_can_be_set() {
    let dir = tempfile::tempdir().unwrap();
    let picture = Picture::new(Rgb32FImage::from_pixel(100, 50, image::Rgb([0.5; 3])));
    let at = |name: &str| dir.path().join(name);
    write_exr(&at("a.exr"), &picture, &ExrOptions::default()).unwrap();
    write_pfm(&at("a.pfm"), &picture).unwrap();
    write_hdr(&at("a.hdr"), &picture).unwrap();
    write_tiff_float(&at("a.tif"), &picture).unwrap();
    write_png8(&at("a.png"), (100, 50), &[7; 15000]).unwrap();
    write_jpeg(&at("a.jpg"), (100, 50), &[7; 15000], 90).unwrap();
    let names = ["a.exr", "a.pfm", "a.hdr", "a.tif", "a.png", "a.jpg"];
    // 100 × 50 × 3 floats are 60,000 bytes.
    for (limit, read) in [(None, true), (Some(60_000), true), (Some(59_999), false), (None, true)] {
        limits::set_max_decoded_bytes(limit);
        for name in names {
            match read_picture(&at(name)) {
                Ok(_) => assert!(read, "{name}, {limit:?}"),
                Err(e) => {
                    let e = e.to_string();
                    assert!(!read && e.contains("60.0 kB when decoded") && e.contains("the limit is 60.0 kB"), "{e}");
                }
            }
        }
        assert_eq!(read_exr_channels(&at("a.exr"), 0).is_ok(), read);
    }
    assert_eq!(limits::max_decoded_bytes(1), 2 << 30);
    assert_eq!(limits::max_decoded_bytes(1 << 30), 64 << 30);
}

#[test]
fn folders_pipes_and_devices_are_no_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let error = read_picture(dir.path()).unwrap_err().to_string();
    assert!(error.contains("a folder"), "{error}");
    for path in ["/dev/zero", "/dev/null"] {
        if Path::new(path).exists() {
            let error = read_picture(Path::new(path)).unwrap_err().to_string();
            assert!(error.contains("not a plain file"), "{error}");
            assert!(Format::of_file(Path::new(path)).is_err() && read_exr_parts(Path::new(path)).is_err());
        }
    }
    // A link to a plain file is one.
    #[cfg(unix)]
    {
        write_png8(&dir.path().join("a.png"), (1, 1), &[7; 3]).unwrap();
        std::os::unix::fs::symlink(dir.path().join("a.png"), dir.path().join("b.png")).unwrap();
        assert!(read_picture(&dir.path().join("b.png")).is_ok());
        // Nobody writes to this pipe: opening it would never return.
        let pipe = dir.path().join("pipe.png");
        if std::process::Command::new("mkfifo").arg(&pipe).status().is_ok_and(|s| s.success()) {
            assert!(read_picture(&pipe).unwrap_err().to_string().contains("pipe"));
        }
    }
}
