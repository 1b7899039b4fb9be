//! Compressing within bounds on memory and on what is solved.

use translume_field::lights::Shot;
use translume_field::{Field, Model, Params, Rate, Result, Stack, compress, measure};
use translume_image::{ExrOptions, Picture, Rgb32FImage, write_exr};

const W: u32 = 400;
const H: u32 = 270;
const MIB: usize = 1 << 20;

/// A wavy surface under twelve lights, on a ground that is black in part.
fn stack(dir: &std::path::Path) -> Stack {
    let shots: Vec<Shot> = (0..12)
        .map(|i| {
            let z = 1.0 - 0.06 * i as f32;
            let (sin, cos) = (2.4 * i as f32).sin_cos();
            let s = (1.0 - z * z).sqrt();
            Shot::new(dir.join(format!("{i}.exr")), [s * cos, s * sin, z])
        })
        .collect();
    for shot in &shots {
        let texel = |x: u32, y: u32| {
            let (u, v) = (x as f32 * 0.35, y as f32 * 0.3);
            let n = [0.45 * u.sin() * v.cos(), 0.4 * (u * 0.5 + v).cos(), 1.0];
            let cos = (0..3).map(|c| n[c] * shot.light[c]).sum::<f32>().max(0.0);
            let lit = if x < 100 && y < 200 { 0.0 } else { 1.0 };
            [0.7, 0.45, 0.25].map(|a| lit * (a * (0.8 + 0.2 * (x as f32 * 0.2).sin()) * cos + 0.3 * cos.powi(9)))
        };
        let samples = (0..W * H).flat_map(|i| texel(i % W, i / W)).collect();
        let pixels = Rgb32FImage::from_raw(W, H, samples).unwrap();
        write_exr(&shot.path, &Picture::new(pixels), &ExrOptions::default()).unwrap();
    }
    Stack::of(dir, shots).unwrap()
}

fn made(stack: &Stack, params: Params) -> Result<Field> {
    compress(&mut stack.clone(), &params, &|_| ())
}

#[test]
fn planes_that_find_no_room_go_to_files_and_the_field_is_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let stack = stack(dir.path());
    // Enough for the pictures, and too little for the planes.
    for (model, rate, memory) in [
        (Model::Layers, Rate::Default, 118),
        (Model::Layers, Rate::Psnr(30.0), 118),
        (Model::LogPca, Rate::Terms(10), 118),
        (Model::Ptm, Rate::Default, 108),
    ] {
        let params = |memory: usize, scratch: &str| {
            let scratch = Some(dir.path().join(scratch));
            Params { model, rate, memory: memory * MIB, scratch, ..Params::default() }
        };
        // Without the folder for files there is no way but to hold all in memory.
        let roomy = made(&stack, params(2048, "none")).unwrap();
        let error = made(&stack, params(memory, "none")).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("none: a temporary file for planes"), "{model:?}: {error}");
        assert!(made(&stack, params(memory, "")).unwrap() == roomy, "{model:?}");
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 12);
}

#[test]
fn stacks_larger_than_the_memory_are_read_twice_and_too_little_is_said_before() {
    let dir = tempfile::tempdir().unwrap();
    let mut stack = stack(dir.path());
    let params =
        |memory: usize| Params { memory: memory * MIB, scratch: Some(dir.path().to_owned()), ..Params::default() };
    let error = made(&stack, params(60)).err().map(|e| e.to_string()).unwrap_or_default();
    let least = error.rsplit_once("at least ").and_then(|(_, rest)| rest.split(' ').next()).unwrap();
    assert!(error.contains("60 MiB of memory are too little for pictures of 400 × 270"), "{error}");
    let least: usize = least.parse().unwrap();
    assert!(made(&stack, params(least - 1)).is_err());
    // The least is enough; what the principal directions are found from is a sample then.
    let field = made(&stack, params(least)).unwrap();
    let roomy = made(&stack, params(2048)).unwrap();
    assert!(field.layers.len() == roomy.layers.len() && field.layers != roomy.layers);
    let mut psnr = |field: &Field| {
        let found = measure::compare(field, &mut stack, &|| ()).unwrap();
        found.iter().map(|e| e.psnr).sum::<f64>() / found.len() as f64
    };
    let (little, much) = (psnr(&field), psnr(&roomy));
    assert!(little > much - 0.5, "{little} dB in the least memory, {much} dB");
}

#[test]
fn of_very_many_pictures_all_shape_the_layers_and_some_are_interpolated_between() {
    let dir = tempfile::tempdir().unwrap();
    let stack = stack(dir.path());
    let params = Params { rate: Rate::Terms(4), ..Params::default() };
    let all = made(&stack, params.clone()).unwrap();
    let mut one = stack.clone();
    let some = compress(&mut one, &Params { nodes: 5, ..params.clone() }, &|_| ()).unwrap();
    let said: Vec<_> = one.warnings.iter().filter(|w| w.contains("of 12 pictures all shape the layers")).collect();
    assert!(said.len() == 1 && said[0].contains("but only 5, spread evenly"), "{:?}", one.warnings);
    assert!(some.layers == all.layers && some.lights().len() == 5);
    // Those keep the weights that they have among all.
    for (i, light) in some.lights().iter().enumerate() {
        let same = all.lights().iter().position(|l| l == light).unwrap();
        let (a, b) = (some.mix_of_light(i).unwrap(), all.mix_of_light(same).unwrap());
        let near = |a: &[f32; 3], b: &[f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-3);
        assert!(near(&a.constant, &b.constant) && a.layers.iter().zip(&b.layers).all(|(a, b)| near(a, b)));
    }
    // The thesis' model finds its directions without the products of all pictures with each other, and as good ones.
    let pca = |nodes: usize| made(&stack, Params { model: Model::LogPca, nodes, ..params.clone() }).unwrap();
    let (exact, some) = (pca(12), pca(5));
    let light = 0;
    let pictures =
        [&exact, &some].map(|f| translume_field::Relighter::new(f).unwrap().picture(&f.mix_of_light(light).unwrap()));
    let (mut error, mut energy) = (0.0, 0.0);
    for (a, b) in pictures[0].iter().zip(&pictures[1]) {
        (error, energy) = (error + (a - b).powi(2), energy + a * a);
    }
    assert!(some.lights().len() == 5 && error < 5e-3 * energy, "{error} of {energy}");
    assert!(made(&stack, Params { nodes: 0, ..params }).is_err());
}
