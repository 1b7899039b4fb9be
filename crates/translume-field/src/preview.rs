//! What a program sees that knows glTF and not our extension: a rectangle with the field lit from the upper left.

use crate::Relighter;
use crate::field::{Angular, Field};
use crate::lights::normalised;
use serde_json::{Map, Value, json};
use translume_image::{colour, encode_jpeg};

/// Longest edge of the picture.
const EDGE: usize = 256;
const QUALITY: u8 = 85;
const FROM: [f32; 3] = [-0.45, 0.45, 0.77];

/// The picture as JPEG: under the stack's light that is nearest to [`FROM`], box-filtered down to [`EDGE`]. `None` for a field that
/// cannot be lit.
fn picture(field: &Field) -> Option<Vec<u8>> {
    let from = normalised(FROM)?;
    let along = |l: &[f32; 3]| (0..3).map(|c| l[c] * from[c]).sum::<f32>();
    let nearest =
        (0..field.lights().len()).max_by(|a, b| along(&field.lights()[*a]).total_cmp(&along(&field.lights()[*b])));
    let mix = match &field.angular {
        Angular::Basis(basis) => field.mix(&basis.at(from)),
        Angular::Lights { .. } => field.mix_of_light(nearest?)?,
    };
    let (w, h) = (field.width, field.height);
    let step = w.max(h).div_ceil(EDGE);
    let size = (w.div_ceil(step), h.div_ceil(step));
    let mut sums = vec![([0.0f32; 3], 0); size.0 * size.1];
    let add = &mut |above: usize, light: &[f32]| {
        for (y, row) in light.chunks(3 * w).enumerate() {
            let sums = &mut sums[(above + y) / step * size.0..][..size.0];
            for (run, (sum, n)) in row.chunks(3 * step).zip(sums) {
                for texel in run.as_chunks::<3>().0 {
                    (0..3).for_each(|c| sum[c] += texel[c]);
                    *n += 1;
                }
            }
        }
    };
    Relighter::by_rows(field, &mix, add).ok()?;
    let code = |sum: f32, n: i32| colour::linear_to_srgb((sum / (n as f32 * field.white)).clamp(0.0, 1.0));
    let rgb: Vec<u8> = sums.iter().flat_map(|(sum, n)| sum.map(|s| (255.0 * code(s, *n) + 0.5) as u8)).collect();
    encode_jpeg(size, &rgb, QUALITY).ok()
}

/// The members of a glTF document that show the picture; `add` takes bytes and what is to be said of them, and gives their buffer view.
pub(crate) fn scene(field: &Field, add: &mut dyn FnMut(&[u8], Value) -> usize) -> Map<String, Value> {
    let Some(jpeg) = picture(field) else { return Map::new() };
    // Corners in the order of a triangle strip that faces the camera; the longer edge is 1.
    let (w, h) = (field.width as f32, field.height as f32);
    let (x, y) = (0.5 * w / w.max(h), 0.5 * h / w.max(h));
    let corners = [[-x, -y, 0.0, 0.0, 1.0], [x, -y, 0.0, 1.0, 1.0], [-x, y, 0.0, 0.0, 0.0], [x, y, 0.0, 1.0, 0.0]];
    let bytes: Vec<u8> = corners.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let corners = add(&bytes, json!({ "byteStride": 20, "target": 34962 }));
    let image = add(&jpeg, json!({}));
    let document = json!({
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "preview" }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "mode": 5, "material": 0 }] }],
        "accessors": [
            { "bufferView": corners, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-x, -y, 0.0], "max": [x, y, 0.0] },
            { "bufferView": corners, "byteOffset": 12, "componentType": 5126, "count": 4, "type": "VEC2" },
        ],
        "materials": [{
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0 },
            "extensions": { "KHR_materials_unlit": {} },
        }],
        "textures": [{ "source": 0, "sampler": 0 }],
        "samplers": [{ "wrapS": 33071, "wrapT": 33071 }],
        "images": [{ "bufferView": image, "mimeType": "image/jpeg", "name": "preview" }],
    });
    match document {
        Value::Object(members) => members,
        _ => Map::new(),
    }
}
