//! Times reading pictures and writing one half ZIP OpenEXR: `time_files OUT.exr IN...`.

use std::{path::PathBuf, time::Instant};

fn main() -> translume_image::Result<()> {
    let mut paths = std::env::args_os().skip(1).map(PathBuf::from);
    let out = paths.next().unwrap_or_else(|| "out.exr".into());
    for path in paths {
        let start = Instant::now();
        let codes = translume_image::read_codes(&path)?;
        let codes_secs = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let picture = translume_image::read_picture(&path)?;
        let picture_secs = start.elapsed().as_secs_f64();
        let start = Instant::now();
        translume_image::write_exr(&out, &picture, &translume_image::ExrOptions::default())?;
        let write_secs = start.elapsed().as_secs_f64();
        println!(
            "{}: {} × {}, codes {codes_secs:.3} s, picture {picture_secs:.3} s, write {write_secs:.3} s, {:?}",
            path.display(),
            codes.width,
            codes.height,
            picture.metadata
        );
    }
    Ok(())
}
