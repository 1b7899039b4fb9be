//! Refractive indices by name, at visible wavelengths (sodium D line or nearest), as in optics tables.

/// Air at standard conditions.
pub const AIR: f32 = 1.000_277;
/// Borosilicate crown glass.
pub const BK7: f32 = 1.5046;
/// Polypropylene, the usual plastic.
pub const POLYPROPYLENE: f32 = 1.49;

const TABLE: [(&str, f32); 23] = [
    ("vacuum", 1.0),
    ("helium", 1.000_036),
    ("hydrogen", 1.000_132),
    ("air", AIR),
    ("carbon dioxide", 1.000_45),
    ("water", 1.333),
    ("acetone", 1.36),
    ("ethanol", 1.361),
    ("carbon tetrachloride", 1.461),
    ("glycerol", 1.4729),
    ("benzene", 1.501),
    ("silicone oil", 1.52045),
    ("bromine", 1.661),
    ("water ice", 1.31),
    ("fused quartz", 1.458),
    ("pyrex", 1.47),
    ("acrylic glass", 1.49),
    ("polypropylene", POLYPROPYLENE),
    ("bk7", BK7),
    ("sodium chloride", 1.544),
    ("amber", 1.55),
    ("pet", 1.575),
    ("diamond", 2.419),
];

/// The index of a named material, `None` for an unknown name.
pub fn ior_by_name(name: &str) -> Option<f32> {
    TABLE.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|t| t.1)
}
