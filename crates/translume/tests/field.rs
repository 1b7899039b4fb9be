//! `translume field` through the program: what it makes, and what it says to bad input.

mod common;

use common::translume;
use std::path::Path;
use translume_image::{ExrOptions, Picture, Rgb32FImage, read_picture, write_exr, write_png8};

const W: u32 = 48;
const H: u32 = 32;

/// Directions on the upper hemisphere, the outer ones 70° from the view.
fn lights(n: usize) -> Vec<[f32; 3]> {
    (0..n)
        .map(|i| {
            let z = 1.0 - 0.66 * (i as f32 + 0.5) / n as f32;
            let (sin, cos) = (2.4 * i as f32).sin_cos();
            let s = (1.0 - z * z).sqrt();
            [s * cos, s * sin, z]
        })
        .collect()
}

/// A wavy surface, matt with a gloss, under a light.
fn picture(l: [f32; 3]) -> Rgb32FImage {
    Rgb32FImage::from_fn(W, H, |x, y| {
        let (u, v) = (x as f32 * 0.35, y as f32 * 0.3);
        let n = [0.45 * u.sin() * v.cos(), 0.4 * (u * 0.5 + v).cos(), 1.0f32];
        let length = (n[0] * n[0] + n[1] * n[1] + 1.0).sqrt();
        let cos = |a: [f32; 3]| (0..3).map(|c| a[c] * n[c]).sum::<f32>().max(0.0) / length;
        let h = [l[0], l[1], l[2] + 1.0];
        let h_length = h.iter().map(|v| v * v).sum::<f32>().sqrt();
        let gloss = 0.3 * (cos(h) / h_length).powi(40);
        image::Rgb([0.7, 0.45, 0.25].map(|a| a * (0.8 + 0.2 * (x as f32 * 0.2).sin()) * cos(l) + gloss))
    })
}

fn write(path: &Path, rgb: Rgb32FImage) {
    if path.extension().is_some_and(|e| e == "exr") {
        return write_exr(path, &Picture::new(rgb), &ExrOptions::default()).unwrap();
    }
    let code = |v: &f32| (translume_image::colour::linear_to_srgb(v.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8;
    write_png8(path, (W as usize, H as usize), &rgb.iter().map(code).collect::<Vec<_>>()).unwrap();
}

/// A stack of `n` pictures in `dir`/stack with an .lp file, and its lights.
fn stack(dir: &Path, n: usize, ending: &str) -> Vec<[f32; 3]> {
    let folder = dir.join("stack");
    std::fs::create_dir(&folder).unwrap();
    let lights = lights(n);
    let mut lp = format!("{n}\n");
    for (i, l) in lights.iter().enumerate() {
        let name = format!("p {i:02}.{ending}");
        write(&folder.join(&name), picture(*l));
        lp += &format!("{name} {} {} {}\n", l[0], l[1], l[2]);
    }
    std::fs::write(folder.join("dome.lp"), lp).unwrap();
    lights
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

/// PSNR of light, peak 1.
fn psnr(path: &Path, truth: &Rgb32FImage) -> f64 {
    let got = read_picture(path).unwrap();
    translume_image::metrics::psnr(truth.as_raw(), got.pixels.as_raw(), 1.0)
}

#[test]
fn a_stack_becomes_a_field_that_relights_between_its_lights() {
    let dir = tempfile::tempdir().unwrap();
    let lights = stack(dir.path(), 24, "png");
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    let made = json(&run(&["field", "compress", "stack", "-o", "f.glb", "--json"]).ok());
    assert_eq!((&made["terms"], &made["lights"], &made["model"]), (&16.into(), &24.into(), &"layers".into()));
    assert_eq!(made["bytes_per_texel"], 8.0);
    // A direction between the lights, against the truth; the nearest picture is much farther off.
    let between = [0.31f32, 0.22, 0.925];
    let truth = picture(between);
    run(&["field", "relight", "f.glb", "--light", "0.31,0.22,0.925", "-o", "o.exr"]).ok();
    let got = psnr(&dir.path().join("o.exr"), &truth);
    let distance = |l: &&[f32; 3]| (0..3).map(|c| (l[c] - between[c]).powi(2)).sum::<f32>();
    let nearest = lights.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
    let next = translume_image::metrics::psnr(truth.as_raw(), picture(*nearest).as_raw(), 1.0);
    assert!(got > 30.0 && got > next + 5.0, "{got:.1} dB, the nearest picture {next:.1} dB");
    // Two lights are the sum of each.
    run(&["field", "relight", "f.glb", "--light", "0.31,0.22,0.925", "--light", "-1,0,1:0,1,0", "-o", "two.exr"]).ok();
    run(&["field", "relight", "f.glb", "--light", "-1,0,1", "-o", "one.exr"]).ok();
    let pixels = |name: &str| read_picture(&dir.path().join(name)).unwrap().pixels.into_raw();
    let (a, b, sum) = (pixels("o.exr"), pixels("one.exr"), pixels("two.exr"));
    assert!((0..sum.len()).all(|i| {
        let expected = a[i] + if i % 3 == 1 { b[i] } else { 0.0 };
        (sum[i] - expected).abs() < 2e-3 * (1.0 + expected)
    }));
    let info = json(&run(&["field", "info", "f.glb", "--json"]).ok());
    assert_eq!((&info["terms"], &info["width"]), (&16.into(), &W.into()));
    assert!(run(&["field", "info", "f.glb"]).ok().contains("16 layers (layers)"));
    let compared = json(&run(&["field", "compare", "stack", "f.glb", "--json"]).ok());
    assert!(compared["own_lights"] == true && compared["psnr"].as_f64().unwrap() > 38.0, "{compared}");
}

#[test]
fn names_hold_directions_and_codes_may_be_light() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let folder = here.join("named");
    std::fs::create_dir(&folder).unwrap();
    let lights = lights(16);
    for l in &lights {
        let (theta, phi) = (l[2].acos().to_degrees(), l[1].atan2(l[0]).to_degrees());
        // Codes that are light: no curve.
        let bytes: Vec<u8> = picture(*l).iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
        write_png8(&folder.join(format!("a t{theta:.3} p{phi:.3}.png")), (W as usize, H as usize), &bytes).unwrap();
    }
    let run = |arguments: &[&str]| translume(here, arguments);
    let pattern = ["--names", "{*}t{theta} p{phi}.png"];
    let compress = ["field", "compress", "named", "-o", "f.glb"];
    run(&[&compress[..], &pattern, &["--linear-codes"]].concat()).ok();
    let [x, y, z] = lights[5];
    run(&["field", "relight", "f.glb", "--light", &format!("{x},{y},{z}"), "-o", "o.exr"]).ok();
    assert!(psnr(&here.join("o.exr"), &picture(lights[5])) > 35.0);
    let compare = ["field", "compare", "named", "f.glb", "--linear-codes", "--json"];
    let compared = json(&run(&[&compare[..], &pattern].concat()).ok());
    assert!(compared["own_lights"] == true && compared["psnr"].as_f64().unwrap() > 35.0, "{compared}");
    // Taken for codes of a display, they are darker.
    run(&[&compress[..], &pattern].concat()).ok();
    run(&["field", "relight", "f.glb", "--light", &format!("{x},{y},{z}"), "-o", "o.exr"]).ok();
    assert!(psnr(&here.join("o.exr"), &picture(lights[5])) < 20.0);
    let error = run(&[&compress[..], &["--names", "{theta}.png"]].concat()).error(1);
    assert!(error.contains("{theta} and {phi} are wanted"), "{error}");
    let error = run(&[&compress[..], &["--names", "b{theta}_{phi}.png"]].concat()).error(1);
    assert!(error.contains("0 pictures with lights"), "{error}");
}

#[test]
fn tiles_get_layers_where_they_serve() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let (w, h) = (170u32, 130u32);
    std::fs::create_dir(here.join("stack")).unwrap();
    let lights = lights(20);
    let mut list = format!("{}\n", lights.len());
    // A wavy patch on a black ground.
    for (i, l) in lights.iter().enumerate() {
        let patch = picture(*l);
        let pixels = Rgb32FImage::from_fn(w, h, |x, y| {
            let inside = (40..40 + W).contains(&x) && (50..50 + H).contains(&y);
            if inside { *patch.get_pixel(x - 40, y - 50) } else { image::Rgb([0.0; 3]) }
        });
        write(&here.join(format!("stack/{i}.exr")), pixels);
        list += &format!("{i}.exr {} {} {}\n", l[0], l[1], l[2]);
    }
    std::fs::write(here.join("stack/d.lp"), list).unwrap();
    let run = |arguments: &[&str]| translume(here, arguments);
    let rms = |tiles: &str| {
        let made = ["field", "compress", "stack", "-o", "f.glb", "--terms", "4", "--tiles", tiles, "--json"];
        let made = json(&run(&made).ok());
        assert!(made["bytes_per_texel"].as_f64().unwrap() < 2.2, "{made}");
        let compared = json(&run(&["field", "compare", "stack", "f.glb", "--json"]).ok());
        (compared["rms"].as_f64().unwrap(), made["layers_by_tile"].clone())
    };
    let ((whole, none), (adaptive, tiles)) = (rms("whole"), rms("auto"));
    assert!(none.is_null() && tiles["most"] == 8 && tiles["without"].as_u64() > Some(10), "{tiles}");
    assert!(adaptive < 0.7 * whole, "{adaptive} against {whole}");
    // What is black stays black.
    run(&["field", "relight", "f.glb", "--light", "0,0,1", "-o", "o.exr"]).ok();
    assert!(read_picture(&here.join("o.exr")).unwrap().pixels.get_pixel(150, 10).0[1] < 1e-3);
    assert!(run(&["field", "info", "f.glb"]).ok().contains("tiles"));
    // Damaged anywhere in its description, it is refused or read, and nothing else.
    let bytes = std::fs::read(here.join("f.glb")).unwrap();
    let text = String::from_utf8_lossy(&bytes[20..6000]).into_owned();
    let at = 20 + text.find("\"side\":32").unwrap() + 7;
    let mut damaged = bytes;
    damaged[at] = b'6';
    std::fs::write(here.join("bad.glb"), &damaged).unwrap();
    assert!(run(&["field", "info", "bad.glb"]).error(1).contains("tiles do not fit"));
    assert!(
        run(&["field", "compress", "stack", "-o", "f.glb", "--model", "ptm", "--tiles", "mask"])
            .error(2)
            .contains("--tiles")
    );
}

#[test]
fn every_model_makes_a_field_and_the_default_is_nearest_at_equal_bytes() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 20, "exr");
    let run = |arguments: &[&str]| json(&translume(dir.path(), arguments).ok());
    let mut rms = std::collections::HashMap::new();
    for (model, options) in [
        ("layers", &["--terms", "8"][..]),
        ("log-pca", &["--terms", "8"]),
        ("linear-pca", &["--terms", "8"]),
        ("ptm", &["--codec", "bc1"]),
        ("hsh", &["--codec", "bc1"]),
    ] {
        let mut arguments = vec!["field", "compress", "stack", "-o", "f.glb", "--model", model, "--json"];
        arguments.extend(options);
        let made = run(&arguments);
        assert_eq!(made["model"], model);
        assert!(made["bytes_per_texel"].as_f64().unwrap() <= 4.5, "{made}");
        let compared = run(&["field", "compare", "stack", "f.glb", "--json"]);
        rms.insert(model, compared["rms"].as_f64().unwrap());
    }
    let ours = rms["layers"];
    assert!(rms.iter().all(|(m, r)| *m == "layers" || *r > 1.2 * ours), "{rms:?}");
}

#[test]
fn bytes_and_psnr_decide_the_number_of_layers() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 12, "png");
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    let made = json(&run(&["field", "compress", "stack", "-o", "f.glb", "--bytes", "14000", "--json"]).ok());
    let bytes = std::fs::metadata(dir.path().join("f.glb")).unwrap().len();
    assert!(bytes <= 14000 && bytes > 8000 && made["bytes"] == bytes, "{bytes}");
    let coarse = json(&run(&["field", "compress", "stack", "-o", "f.glb", "--psnr", "32", "--json"]).ok());
    let compared = json(&run(&["field", "compare", "stack", "f.glb", "--json"]).ok());
    assert!(compared["psnr"].as_f64().unwrap() > 31.5, "{compared}");
    let fine = json(&run(&["field", "compress", "stack", "-o", "f.glb", "--psnr", "44", "--json"]).ok());
    assert!(fine["terms"].as_u64() > coarse["terms"].as_u64(), "{fine} {coarse}");
    let error = run(&["field", "compress", "stack", "-o", "f.glb", "--bytes", "2000"]).error(1);
    assert!(error.contains("hold no layer"), "{error}");
    let error = run(&["field", "compress", "stack", "-o", "f.glb", "--psnr", "190"]).error(1);
    assert!(error.contains("out of reach"), "{error}");
}

#[test]
fn scales_colour_and_planes_of_16_bits_can_be_chosen() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 20, "exr");
    let compress = |options: &[&str]| {
        translume(dir.path(), &[&["field", "compress", "stack", "-o", "f.glb", "--json"][..], options].concat())
    };
    let compared = || json(&translume(dir.path(), &["field", "compare", "stack", "f.glb", "--json"]).ok());
    for (scale, kind) in [("root", "root"), ("log", "log"), ("display", "display"), ("pu21", "pu21")] {
        let made = json(&compress(&["--scale", scale, "--terms", "8"]).ok());
        assert_eq!(made["scale"]["kind"], kind);
        assert!(compared()["psnr"].as_f64().unwrap() > 36.0, "{scale}");
    }
    assert_eq!(json(&compress(&["--scale", "log", "--delta", "0.05"]).ok())["scale"]["delta"], 0.05f32);
    let made = json(&compress(&["--residual", "1"]).ok());
    assert_eq!(
        (&made["codecs"][12], &made["terms"], &made["bytes_per_texel"]),
        (&"r16".into(), &13.into(), &8.0.into())
    );
    assert!(compared()["psnr"].as_f64().unwrap() > 36.0);
    let made = json(&compress(&["--codec", "bc6h", "--terms", "6"]).ok());
    assert_eq!((&made["codecs"][0], &made["bytes_per_texel"]), (&"bc6h".into(), &6.0.into()));
    assert!(compared()["psnr"].as_f64().unwrap() > 36.0);
    // Luminance is nearer to the pictures when colour counts for little, with few layers.
    let luminance = |chroma: &str| {
        compress(&["--terms", "2", "--codec", "bc4", "--chroma", chroma]).ok();
        let truth = read_picture(&dir.path().join("stack/p 07.exr")).unwrap().pixels;
        let [x, y, z] = lights(20)[7];
        let light = format!("{x},{y},{z}");
        translume(dir.path(), &["field", "relight", "f.glb", "--light", &light, "-o", "o.exr"]).ok();
        let got = read_picture(&dir.path().join("o.exr")).unwrap().pixels;
        let grey = |p: &image::Rgb<f32>| p.0.iter().sum::<f32>();
        got.pixels().zip(truth.pixels()).map(|(a, b)| (grey(a) - grey(b)).powi(2)).sum::<f32>()
    };
    let (even, little) = (luminance("1"), luminance("0.1"));
    assert!(little < even, "{little} {even}");
    assert!(compress(&["--chroma", "0"]).error(1).contains("must be positive"));
    assert!(compress(&["--residual", "4"]).error(1).contains("more than 16 terms"));
    assert!(compress(&["--residual", "1", "--tiles", "adaptive"]).error(2).contains("tiles"));
    assert!(compress(&["--scale", "pu21", "--delta", "0.1"]).error(2).contains("no logarithm"));
    for option in [["--scale", "log"], ["--chroma", "0.5"], ["--residual", "1"]] {
        let error = compress(&[&option[..], &["--model", "log-pca"]].concat()).error(2);
        assert!(error.contains("only the model `layers`"), "{error}");
    }
}

/// A BTF: each column of the matrix is a direction to the light and one to the camera.
#[test]
fn pictures_from_several_views_are_seen_from_between() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    std::fs::create_dir(here.join("btf")).unwrap();
    let (w, h) = (24, 16);
    let unit = |v: [f32; 3]| {
        let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
        v.map(|x| x / length)
    };
    // Matt threads with a broad gloss that moves with the camera.
    let texels = |l: [f32; 3], v: [f32; 3]| {
        let half = unit([l[0] + v[0], l[1] + v[1], l[2] + v[2]]);
        Rgb32FImage::from_fn(w, h, |x, y| {
            let n = unit([0.3 * (x as f32 * 0.8).sin(), 0.3 * (y as f32 * 0.7).cos(), 1.0]);
            let dot = |a: [f32; 3]| (0..3).map(|c| a[c] * n[c]).sum::<f32>().max(0.0);
            image::Rgb([0.5, 0.2, 0.1].map(|a| a * dot(l) + 0.6 * dot(half).powi(12) * dot(l)))
        })
    };
    let from = |i: usize, n: usize, tilt: f32| {
        let (sin, cos) = (std::f32::consts::TAU * i as f32 / n as f32).sin_cos();
        unit([tilt * cos, tilt * sin, 1.0])
    };
    let mut list = String::from("file,x,y,z,vx,vy,vz\n");
    for (i, l) in (0..9).map(|i| from(i, 8, if i < 8 { 0.9 } else { 0.0 })).enumerate() {
        for (j, v) in (0..7).map(|j| from(j, 6, if j < 6 { 0.7 } else { 0.0 })).enumerate() {
            let name = format!("l{i} v{j}.exr");
            write_exr(&here.join("btf").join(&name), &Picture::new(texels(l, v)), &ExrOptions::default()).unwrap();
            list += &format!("{name},{},{},{},{},{},{}\n", l[0], l[1], l[2], v[0], v[1], v[2]);
        }
    }
    std::fs::write(here.join("btf/lights.csv"), &list).unwrap();
    let run = |arguments: &[&str]| translume(here, arguments);
    let made = json(&run(&["field", "compress", "btf", "-o", "b.glb", "--json"]).ok());
    assert_eq!((&made["lights"], &made["several_views"]), (&63.into(), &true.into()));
    let compared = json(&run(&["field", "compare", "btf", "b.glb", "--json"]).ok());
    assert!(compared["own_lights"] == true && compared["psnr"].as_f64().unwrap() > 36.0, "{compared}");
    assert!(run(&["field", "info", "b.glb"]).ok().contains("63 directions of light and view"));
    // Between lights and views; the view along the normal is another picture.
    let (l, v) = (unit([0.5, 0.2, 1.0]), unit([-0.4, -0.1, 1.0]));
    let text = |d: [f32; 3]| format!("{},{},{}", d[0], d[1], d[2]);
    run(&["field", "relight", "b.glb", "--light", &text(l), "--view", &text(v), "-o", "seen.exr"]).ok();
    run(&["field", "relight", "b.glb", "--light", &text(l), "-o", "above.exr"]).ok();
    let (seen, above) = (psnr(&here.join("seen.exr"), &texels(l, v)), psnr(&here.join("above.exr"), &texels(l, v)));
    assert!(seen > 30.0 && seen > above + 6.0, "{seen:.1} dB, from above {above:.1} dB");
    assert!(run(&["field", "compress", "btf", "-o", "p.glb", "--model", "ptm"]).error(1).contains("several views"));
    // One view of it is a field like any other, and has no other views.
    let one: String =
        list.lines().filter(|line| !line.contains(" v") || line.contains(" v6")).map(|l| format!("{l}\n")).collect();
    std::fs::write(here.join("btf/lights.csv"), one.replace("file,x,y,z,vx,vy,vz", "file,x,y,z")).unwrap();
    assert!(run(&["field", "compress", "btf", "-o", "p.glb"]).error(1).contains("pictures is there"));
    let short = |line: &str| line.split(',').take(4).collect::<Vec<_>>().join(",") + "\n";
    std::fs::write(here.join("btf/lights.csv"), one.lines().map(short).collect::<String>()).unwrap();
    run(&["field", "compress", "btf", "-o", "p.glb", "--terms", "4"]).ok();
    let view = ["field", "relight", "p.glb", "--light", "0,0,1", "--view", "0,0,1", "-o", "o.exr"];
    assert!(run(&view).error(2).contains("one view"));
}

#[test]
fn the_least_memory_is_said_and_is_enough() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 12, "exr");
    let error = translume(dir.path(), &["field", "compress", "stack", "-o", "f.glb", "--memory", "0"]).error(1);
    let least = error.split_once("at least ").and_then(|(_, rest)| rest.split(' ').next()).unwrap().to_owned();
    assert!(error.contains("too little") && !dir.path().join("f.glb").exists(), "{error}");
    let run = |arguments: &[&str]| json(&translume(dir.path(), arguments).ok());
    let mut psnr = Vec::new();
    for memory in ["2048", &least] {
        run(&["field", "compress", "stack", "-o", "f.glb", "--memory", memory, "--json"]);
        psnr.push(run(&["field", "compare", "stack", "f.glb", "--json"])["psnr"].as_f64().unwrap());
    }
    assert!(psnr[1] > 35.0 && psnr[1] > psnr[0] - 3.0, "{psnr:?}");
}

#[test]
fn an_environment_map_and_a_disc_light_a_field() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 24, "exr");
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    run(&["field", "compress", "stack", "-o", "f.glb"]).ok();
    // A map that is dark but for a spot at z, of the light of one lamp: the picture of that lamp.
    let (w, h) = (64u32, 32u32);
    let spot = |x: u32, y: u32| (x == 31 || x == 32) && (y == 15 || y == 16);
    let area = 4.0 * (std::f32::consts::TAU / w as f32) * (std::f32::consts::PI / h as f32);
    let map =
        Rgb32FImage::from_fn(w, h, |x, y| image::Rgb([if spot(x, y) { std::f32::consts::PI / area } else { 0.0 }; 3]));
    write_exr(&dir.path().join("map.exr"), &Picture::new(map), &ExrOptions::default()).unwrap();
    run(&["field", "relight", "f.glb", "--env", "map.exr", "-o", "env.exr"]).ok();
    run(&["field", "relight", "f.glb", "--light", "0,0,1", "-o", "one.exr"]).ok();
    run(&["field", "relight", "f.glb", "--light", "0,0,1", "--size", "8", "-o", "disc.exr"]).ok();
    let one = read_picture(&dir.path().join("one.exr")).unwrap().pixels;
    assert!(psnr(&dir.path().join("env.exr"), &one) > 35.0);
    assert!(psnr(&dir.path().join("disc.exr"), &one) > 35.0);
    // Light from below the horizon is none of the stack's.
    let behind = Rgb32FImage::from_fn(w, h, |x, _| image::Rgb([if x < 2 { 1.0 } else { 0.0 }; 3]));
    write_exr(&dir.path().join("behind.exr"), &Picture::new(behind), &ExrOptions::default()).unwrap();
    let dark = run(&["field", "relight", "f.glb", "--env", "behind.exr", "-o", "dark.exr", "--json"]);
    assert!(dark.stderr.contains("left out"), "{}", dark.stderr);
    let dark = json(&dark.ok());
    assert!(dark["light_left_out"].as_f64().unwrap() > 0.9, "{dark}");
}

#[test]
fn a_report_has_the_plots_and_pictures() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 12, "exr");
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    run(&["field", "compress", "stack", "-o", "f.glb"]).ok();
    let found = json(&run(&["field", "compare", "stack", "f.glb", "--report", "page", "--json"]).ok());
    let curve = |name: &str| -> Vec<f64> {
        found["report"][name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    for name in ["rms_log_pca", "rms_linear_pca"] {
        let curve = curve(name);
        assert!(curve.len() == 12 && curve[11] < 0.1 * curve[0], "{curve:?}");
    }
    let page = std::fs::read_to_string(dir.path().join("page/index.html")).unwrap();
    for file in ["rms.svg", "worst-this-field.png", "median-as-photographed.png"] {
        assert!(page.contains(file) && dir.path().join("page").join(file).is_file(), "{file}");
    }
}

/// The error line of `field compress stack -o f.glb` and more options; no file is left behind.
#[track_caller]
fn refused(dir: &Path, options: &[&str], status: i32, expected: &str) {
    let mut arguments = vec!["field", "compress", "stack", "-o", "f.glb"];
    arguments.extend(options);
    let before: Vec<_> = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name()).collect();
    let error = translume(dir, &arguments).error(status);
    assert!(error.contains(expected), "{error}, but {expected} was expected");
    let after: Vec<_> = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(before.len(), after.len(), "something was left behind: {after:?}");
}

#[test]
fn stacks_that_are_none_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    stack(here, 6, "png");
    let lp = here.join("stack/dome.lp");
    let text = std::fs::read_to_string(&lp).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    // A direction is missing; all pictures are missing; one picture alone.
    std::fs::write(&lp, text.replace(lines[3], "p 02.png")).unwrap();
    refused(here, &[], 1, "dome.lp: line 4: a picture and its direction x y z are wanted");
    std::fs::write(&lp, text.replace("p 0", "q 0")).unwrap();
    refused(here, &[], 1, "none of its 6 pictures is there: q 00.png");
    std::fs::write(&lp, format!("1\n{}\n", lines[1])).unwrap();
    refused(here, &[], 1, "1 pictures with lights: a field needs 3 or more");
    std::fs::remove_file(&lp).unwrap();
    refused(here, &[], 1, "no light directions");
    std::fs::write(here.join("stack/lights.txt"), "0 0 1\n1 0 1\n").unwrap();
    refused(here, &[], 1, "2 directions for 6 pictures");
    std::fs::write(&lp, &text).unwrap();
    // More terms than pictures.
    refused(here, &["--model", "log-pca", "--terms", "7"], 1, "7 terms: 6 pictures give at most 6");
    refused(here, &["--terms", "0"], 1, "no terms");
    refused(here, &["--model", "hsh"], 1, "6 lights do not determine the 9 terms");
    refused(here, &["--model", "ptm", "--codec", "bc4"], 1, "three channels: bc1, bc6h, bc7 or rgb8");
    refused(here, &["--model", "ptm", "--terms", "6"], 2, "fixed number of terms");
    refused(here, &["--model", "ptm", "--delta", "0.1"], 2, "no logarithm");
    refused(here, &["--delta", "-1"], 2, "positive");
    // A picture of another size, and a damaged one.
    let odd = Rgb32FImage::from_pixel(W + 1, H, image::Rgb([0.5; 3]));
    write_exr(&here.join("stack/p 04.exr"), &Picture::new(odd), &ExrOptions::default()).unwrap();
    std::fs::write(&lp, text.replace("p 04.png", "p 04.exr")).unwrap();
    refused(here, &[], 1, "p 04.exr: 49 × 32 pixels, but");
    std::fs::write(here.join("stack/p 04.exr"), b"\x76\x2f\x31\x01 and no more").unwrap();
    refused(here, &[], 1, "p 04.exr: ");
}

#[test]
fn black_pictures_and_bad_pixels_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let lights = stack(here, 8, "exr");
    let path = |i: usize| here.join(format!("stack/p {i:02}.exr"));
    let black = || Rgb32FImage::new(W, H);
    // One black picture, one with pixels that are no light: said, and the rest is used.
    write(&path(3), black());
    let mut bad = picture(lights[5]);
    bad.put_pixel(3, 4, image::Rgb([f32::NAN, f32::INFINITY, -5.0]));
    let options = ExrOptions { precision: translume_image::Precision::Float, ..ExrOptions::default() };
    write_exr(&path(5), &Picture::new(bad), &options).unwrap();
    let run = translume(here, &["field", "compress", "stack", "-o", "f.glb", "--json"]);
    for expected in ["1 of the pictures are all black", "2 samples are NaN or infinite", "1 samples are far below zero"]
    {
        assert!(run.stderr.contains(expected), "{expected}: {}", run.stderr);
    }
    assert_eq!(json(&run.ok())["warnings"].as_array().unwrap().len(), 3);
    std::fs::remove_file(here.join("f.glb")).unwrap();
    (0..8).for_each(|i| write(&path(i), black()));
    refused(here, &[], 1, "the pictures are black");
}

#[test]
fn damaged_fields_and_wrong_options_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    stack(here, 6, "png");
    let run = |arguments: &[&str]| translume(here, arguments);
    run(&["field", "compress", "stack", "-o", "f.glb", "--terms", "4"]).ok();
    let bytes = std::fs::read(here.join("f.glb")).unwrap();
    for cut in [0, 11, 40, 900, bytes.len() - 1] {
        std::fs::write(here.join("cut.glb"), &bytes[..cut]).unwrap();
        let error = run(&["field", "info", "cut.glb"]).error(1);
        assert!(error.starts_with("cut.glb: "), "{error}");
        assert!(
            run(&["field", "relight", "cut.glb", "--light", "0,0,1", "-o", "o.exr"]).error(1).starts_with("cut.glb: ")
        );
        assert!(!here.join("o.exr").exists());
    }
    assert!(run(&["field", "relight", "f.glb", "-o", "o.exr"]).error(2).contains("--light or --env"));
    assert!(run(&["field", "relight", "f.glb", "--light", "0,0,0", "-o", "o.exr"]).error(2).contains("a direction"));
    assert!(
        run(&["field", "relight", "f.glb", "--light", "0,0,1", "-o", "o.jpg"])
            .error(2)
            .contains(".exr, .hdr, .pfm or .png")
    );
    assert!(
        run(&["field", "relight", "f.glb", "--light", "0,0,1", "-o", "no/o.exr"]).error(1).contains("does not exist")
    );
    // Pictures of another size than the field's.
    let other = tempfile::tempdir().unwrap();
    let small = |i: usize| Rgb32FImage::from_pixel(8, 8, image::Rgb([0.1 * (i + 1) as f32; 3]));
    for i in 0..3 {
        write_exr(&other.path().join(format!("{i}.exr")), &Picture::new(small(i)), &ExrOptions::default()).unwrap();
    }
    std::fs::write(other.path().join("lights.csv"), "file,x,y,z\n0.exr,0,0,1\n1.exr,1,0,1\n2.exr,0,1,1\n").unwrap();
    let folder = other.path().to_string_lossy();
    assert!(
        run(&["field", "compare", &folder, "f.glb"]).error(1).contains("the field is 48 × 32, the pictures are 8 × 8")
    );
}

#[test]
fn planes_go_out_to_relightlab_and_come_back() {
    let dir = tempfile::tempdir().unwrap();
    stack(dir.path(), 24, "png");
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    run(&["field", "compress", "stack", "-o", "f.glb"]).ok();
    let out = json(&run(&["field", "export", "f.glb", "--relight", "web", "--json"]).ok());
    assert_eq!(out["planes"], 27);
    let info = json(&std::fs::read_to_string(dir.path().join("web/info.json")).unwrap());
    assert_eq!((&info["type"], &info["nplanes"], &info["colorspace"]), (&"hsh".into(), &27.into(), &"rgb".into()));
    run(&["field", "import", "web", "-o", "back.glb"]).ok();
    let compared = json(&run(&["field", "compare", "stack", "back.glb", "--json"]).ok());
    assert!(compared["psnr"].as_f64().unwrap() > 24.0, "{compared}");
    assert!(run(&["field", "import", "stack", "-o", "no.glb"]).error(1).contains("info.json"));
    assert!(!dir.path().join("no.glb").exists());
}

#[test]
fn a_ball_gives_the_directions_of_the_lights() {
    let dir = tempfile::tempdir().unwrap();
    let lights = lights(12);
    for (i, l) in lights.iter().enumerate() {
        let ball = Rgb32FImage::from_fn(64, 64, |x, y| {
            let (nx, ny) = ((x as f32 - 32.0) / 28.0, (32.0 - y as f32) / 28.0);
            let nz = (1.0 - nx * nx - ny * ny).max(0.0).sqrt();
            image::Rgb([if nz > 0.0 { 0.8 * (nx * l[0] + ny * l[1] + nz * l[2]).max(0.0) } else { 0.0 }; 3])
        });
        write_exr(&dir.path().join(format!("b{i}.exr")), &Picture::new(ball), &ExrOptions::default()).unwrap();
    }
    let run = |arguments: &[&str]| translume(dir.path(), arguments);
    let found = ["field", "lights", ".", "--ball", "32,32,28", "--surface", "matt", "-o", "b.lp", "--json"];
    let found = json(&run(&found).ok());
    for (i, l) in lights.iter().enumerate() {
        let got = &found["lights"][i];
        let dot: f64 = (0..3).map(|c| got["direction"][c].as_f64().unwrap() * f64::from(l[c])).sum();
        assert!(dot > 0.9999 && (got["strength"].as_f64().unwrap() - 0.8).abs() < 0.02, "{got}");
    }
    // The list is one that compress takes.
    run(&["field", "compress", ".", "-o", "f.glb", "--terms", "3"]).ok();
    // The ball in other files, one of which has no partner; strengths in the list, by which compress divides.
    std::fs::create_dir(dir.path().join("objects")).unwrap();
    for i in 0..12 {
        let mut object = read_picture(&dir.path().join(format!("b{i}.exr"))).unwrap().pixels;
        object.pixels_mut().for_each(|p| p.0 = p.0.map(|v| v * (1.0 + i as f32 * 0.1)));
        write(&dir.path().join(format!("objects/b{i}.exr")), object);
    }
    std::fs::copy(dir.path().join("b0.exr"), dir.path().join("without.exr")).unwrap();
    let ball = ["field", "lights", ".", "--ball", "32,32,28", "--surface", "matt", "--pictures", "objects"];
    let made = run(&[&ball[..], &["-o", "objects/lights.csv"]].concat());
    assert!(made.stderr.contains("1 pictures have no partner"), "{}", made.stderr);
    assert!(made.ok().contains("12 directions, strengths from 1.00 to 1.00"));
    // From the object itself.
    let own = ["field", "lights", "objects", "--lights", "objects/lights.csv", "--strengths", "--json", "-o"];
    let found = json(&run(&[&own[..], &["objects/strong.csv"]].concat()).ok());
    for i in 0..12 {
        let (strength, truth) = (found["lights"][i]["strength"].as_f64().unwrap(), (1.0 + 0.1 * i as f64) / 1.55);
        assert!((strength / truth - 1.0).abs() < 0.1, "{i}: {strength} for {truth}");
    }
    run(&["field", "compress", "objects", "-o", "o.glb", "--terms", "6"]).ok();
    run(&["field", "relight", "o.glb", "--light", "0,0,1", "-o", "o.exr"]).ok();
    assert!(run(&[&own[..], &["x.lp"]].concat()).error(2).contains(".csv"));
    let error = run(&["field", "lights", ".", "--ball", "500,32,28", "-o", "b.lp"]).error(1);
    assert!(error.contains("b0.exr: the ball at (500, 32)"), "{error}");
    assert!(run(&["field", "lights", ".", "--ball", "32,32", "-o", "b.lp"]).error(2).contains("x,y,r"));
}

/// Lists of other machines: read, with a word about what is odd; and without one, where nothing is.
#[test]
fn lists_of_other_machines_are_read_and_what_is_odd_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    stack(here, 8, "png");
    let lp = here.join("stack/dome.lp");
    let text = std::fs::read_to_string(&lp).unwrap();
    let compress = |list: &[u8]| {
        std::fs::write(&lp, list).unwrap();
        let run = translume(here, &["field", "compress", "stack", "-o", "f.glb", "--terms", "4", "--json"]);
        let said = run.stderr.clone();
        (json(&run.ok())["lights"].as_u64().unwrap(), said)
    };
    let silent = |list: &[u8]| {
        let (lights, said) = compress(list);
        assert!(lights == 8 && !said.contains("warning"), "{lights}: {said}");
    };
    silent(text.as_bytes());
    silent(text.replace('.', ",").replace(",png", ".png").as_bytes());
    silent(&text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
    silent(&text.replace("p 0", "C:\\f\u{fc}r\\p 0").chars().map(|c| c as u8).collect::<Vec<u8>>());
    let odd = |list: &str, lights: u64, word: &str| {
        let (found, said) = compress(list.as_bytes());
        assert!(found == lights && said.contains(word), "{found}: {said} instead of {word}");
    };
    odd(&text.replace(".png", ".JPG"), 8, "8 names differ from the pictures in case or ending");
    odd(&text.replace("p 03", "q 03"), 7, "1 of its pictures are missing and left out: q 03.png");
    odd(&text.replacen('8', "9", 1), 8, "9 pictures announced, 8 listed");
    let first = text.lines().nth(1).unwrap();
    odd(&text.replace(first, "p 00.png 0.6 0 -0.8"), 8, "1 of 8 lights are below the horizon");
    assert!(!std::fs::read_to_string(&lp).unwrap().contains("warning"));
    std::fs::write(&lp, text.replace(first, "p 00.png 0 0 0")).unwrap();
    refused(here, &[], 1, "line 2: (0, 0, 0) is no direction");
}

#[test]
fn a_ball_that_is_not_there_is_refused_and_lists_hold_no_absolute_paths() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    stack(here, 12, "exr");
    let error = translume(here, &["field", "lights", "stack", "--ball", "20,16,12", "-o", "b.lp"]).error(1);
    assert!(error.contains("shows no light: is it there?"), "{error}");
    assert!(!here.join("b.lp").exists());
    let absolute = here.join("stack");
    let known =
        ["field", "lights", &absolute.to_string_lossy(), "--lights", "stack/dome.lp", "--strengths", "-o", "l.csv"];
    translume(here, &known).ok();
    let list = std::fs::read_to_string(here.join("l.csv")).unwrap();
    assert!(list.contains("\nstack/p 00.exr,") && !list.contains(&*here.to_string_lossy()), "{list}");
}
