//! Pictures of every format.

use super::Said;
use crate::input::Input;
use std::path::Path;
use translume_image::{
    Codes, Format, Picture, Samples, TextureCodes, decode_codes, decode_picture, decode_texture, read_exr_channels,
    read_exr_parts, read_layer, read_picture,
};

pub(super) fn run(folder: &Path, input: &Input) -> Said {
    let Some((name, bytes)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let path = folder.join(name);
    // One at a time: a few bytes may be a large picture.
    let is_read = read_picture(&path).is_ok();
    let picture = decode_picture(bytes, &path);
    assert_eq!(picture.is_ok(), is_read, "from memory and from the file");
    picture.iter().for_each(sound);
    let said = Said::of(&picture, |_| String::new());
    drop(picture);
    if let Ok(c) = &decode_codes(bytes, &path) {
        let n = match &c.samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
            Samples::F32(v) => v.len(),
        };
        assert_eq!(n, 3 * c.width * c.height, "codes of {} × {}", c.width, c.height);
        upright(c);
    }
    decode_texture(bytes, &path, TextureCodes::Srgb).iter().for_each(sound);
    if Format::of(bytes) != Some(Format::Exr) {
        return said;
    }
    let parts = read_exr_parts(&path);
    for (i, _) in parts.iter().flatten().enumerate().take(4) {
        if let Ok(planes) = read_exr_channels(&path, i) {
            let n = planes.planes.first().map_or(0, |p| p.1.len());
            assert!(planes.planes.iter().all(|p| p.1.len() == n), "planes of one size");
        }
    }
    read_layer(&path, "albedo").iter().for_each(sound);
    said.and(Said::of(&parts, |p| format!("{} parts", p.len())))
}

fn upright(codes: &Codes) {
    assert!(codes.width > 0 && codes.height > 0, "a picture without pixels");
}

fn sound(picture: &Picture) {
    let (w, h) = picture.pixels.dimensions();
    assert!(w > 0 && h > 0, "a picture without pixels");
    if let Some(alpha) = &picture.alpha {
        assert_eq!(alpha.len(), w as usize * h as usize, "alpha of {w} × {h}");
    }
}
