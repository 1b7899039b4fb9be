//! `translume demo`: the page is there, all its pictures are, and the merge is worth it.

mod common;

use common::translume;
use std::fs;
use tempfile::tempdir;

#[test]
fn the_page_is_whole_and_the_figures_are_good() {
    let dir = tempdir().unwrap();
    let json: serde_json::Value =
        serde_json::from_str(&translume(dir.path(), &["demo", "o u t", "--json"]).ok()).unwrap();
    assert_eq!(json["page"], "o u t/index.html");
    let page = fs::read_to_string(dir.path().join("o u t/index.html")).unwrap();
    let files: Vec<&str> = page.split("src=\"").skip(1).filter_map(|s| s.split('"').next()).collect();
    assert!(files.len() >= 9 && files.iter().all(|f| dir.path().join("o u t").join(f).exists()), "{files:?}");
    assert!(!page.contains("http"), "nothing from elsewhere");

    let hdr = &json["figures"]["hdr"];
    let db = |merge: &str| hdr["psnr_mu_db"][merge].as_f64().unwrap();
    assert!(db("default") > db("global") + 3.0 && db("global") > db("tripod") + 3.0, "{hdr}");
    assert!(db("default") > db("single") + 3.0, "{hdr}");
    // Four times the samples, a quarter of the error; caustics make that rough.
    let error: Vec<f64> = (0..3).map(|i| json["figures"]["render"]["rel_mse"][i].as_f64().unwrap()).collect();
    assert!(error.windows(2).all(|e| e[1] < 0.5 * e[0]) && error[2] > 0.0, "{error:?}");

    let lights = &json["figures"]["lights"]["rel_mse"];
    assert!(["path", "bdpt", "photonmap", "gkernel"].iter().all(|m| lights[m].as_f64().unwrap() < 10.0), "{lights}");

    // Of another marble, or by F or K alone, it would be 0.3 to 0.9 in one of the lights.
    let scatter = &json["figures"]["scatter"]["error"];
    for light in ["behind", "spot"] {
        let error = |model: &str| scatter[light][model].as_f64().unwrap();
        assert!(error("hierarchical") < 0.27 && error("hierarchical") < 0.55 * error("dipole"), "{light}: {scatter}");
    }
    for file in ["object.ply", "capture/rig.json", "model/model.json", "dipole/model.json", "behind.json", "spot.json"]
    {
        assert!(dir.path().join("o u t/scatter").join(file).exists(), "{file}");
    }

    let field = &json["figures"]["field"]["psnr_db"];
    assert!(field["layers"].as_f64().unwrap() > field["log_pca"].as_f64().unwrap() + 2.0, "{field}");
    assert!([0, 2].iter().all(|i| hdr["end_point_error_px"][*i].as_f64().unwrap() < 0.5), "{hdr}");
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("taken"), "").unwrap();
    assert!(translume(dir.path(), &["demo", "taken"]).error(1).contains("taken"));
}
