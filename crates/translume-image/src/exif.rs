//! The facts of the shot from an EXIF block.

use crate::{Metadata, orient::Orientation};
use exif::{Exif, Field, In, Tag, Value};

/// What a block says beside the facts of the shot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Block {
    pub orientation: Orientation,
    /// The optional colour space of DCF 2.0, Adobe RGB: cameras say it by the index R03 and embed no profile.
    pub adobe_rgb: bool,
}

/// Fills what `block` (a TIFF structure, as it stands in JPEG, PNG and TIFF files) says into `metadata`.
/// Damaged fields are left out: a broken tag is no reason to refuse the pixels.
pub(crate) fn read_block(block: Vec<u8>, metadata: &mut Metadata) -> Block {
    let mut reader = exif::Reader::new();
    reader.continue_on_error(true);
    match reader.read_raw(block).or_else(|e| e.distill_partial_result(|_| ())) {
        Ok(exif) => {
            let field = |tag| Exif::get_field(&exif, tag, In::PRIMARY);
            let index = field(Tag::InteroperabilityIndex).and_then(|f| text(&f.value));
            Block { orientation: fill(&field, metadata), adobe_rgb: index.as_deref() == Some("R03") }
        }
        Err(_) => Block::default(),
    }
}

/// [`read_block`] for fields that were read one by one (TIFF files).
pub(crate) fn read_fields(fields: &[Field], metadata: &mut Metadata) {
    fill(&|tag| fields.iter().find(|f| f.tag == tag && f.ifd_num == In::PRIMARY), metadata);
}

/// The numbers of the tags that [`read_fields`] looks at.
pub(crate) const TAGS: [u16; 17] = [
    0x010f, 0x0110, 0x0132, 0x013b, 0x8298, 0x829a, 0x829d, 0x8827, 0x8830, 0x8831, 0x8832, 0x8833, 0x9003, 0x9201,
    0x9202, 0x9291, 0xa402,
];

fn fill<'a>(field: &dyn Fn(Tag) -> Option<&'a Field>, metadata: &mut Metadata) -> Orientation {
    let value = |tag| field(tag).and_then(|f| number(&f.value));
    let positive = |tag| value(tag).filter(|v| v.is_finite() && *v > 0.0);
    let words = |tag| field(tag).and_then(|f| text(&f.value));
    // APEX values stand in where the plain ones are missing: t = 2^-Tv, N = 2^(Av/2).
    metadata.exposure_secs =
        positive(Tag::ExposureTime).or_else(|| value(Tag::ShutterSpeedValue).map(|tv| (-tv).exp2()).filter(sane));
    metadata.f_number =
        positive(Tag::FNumber).or_else(|| value(Tag::ApertureValue).map(|av| (av / 2.0).exp2()).filter(sane));
    // 65535 of 16 bits says that the number is in one of the newer tags (EXIF 2.3, §4.6.5).
    metadata.iso = positive(Tag::PhotographicSensitivity)
        .filter(|v| *v != 65535.0)
        .or_else(|| positive(Tag::RecommendedExposureIndex))
        .or_else(|| positive(Tag::StandardOutputSensitivity))
        .or_else(|| positive(Tag::ISOSpeed))
        .or_else(|| positive(Tag::PhotographicSensitivity));
    metadata.camera = match (words(Tag::Make), words(Tag::Model)) {
        (Some(make), Some(model)) if !model.starts_with(&make) => Some(format!("{make} {model}")),
        (make, model) => model.or(make),
    };
    metadata.owner = words(Tag::Copyright).or_else(|| words(Tag::Artist));
    metadata.date_time = words(Tag::DateTimeOriginal).or_else(|| words(Tag::DateTime));
    metadata.captured_secs =
        words(Tag::DateTimeOriginal).and_then(|t| seconds(&t, words(Tag::SubSecTimeOriginal).as_deref()));
    metadata.auto_bracket = value(Tag::ExposureMode).map(|mode| mode == 2.0);
    Orientation::from_exif(value(Tag::Orientation).map_or(1, |v| v as u32))
}

fn sane(v: &f64) -> bool {
    v.is_finite() && *v > 0.0
}

/// Seconds of `2026:01:31 23:59:08` and the decimals of a second behind it, from a fixed origin; `None` for what is no date.
fn seconds(text: &str, decimals: Option<&str>) -> Option<f64> {
    let parts: Vec<i64> = text.split([':', ' ', '-', 'T']).map(|p| p.parse().ok()).collect::<Option<_>>()?;
    let [year, month, day, hour, minute, second] = parts[..] else { return None };
    let calendar = (1..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    if !(calendar && (0..24).contains(&hour) && (0..60).contains(&minute) && (0..=60).contains(&second)) {
        return None;
    }
    // Days of the proleptic Gregorian calendar, the year beginning in March so that its leap day comes last.
    let (y, m) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days = 365 * y + y / 4 - y / 100 + y / 400 + (153 * m + 2) / 5 + day;
    let fraction = decimals.and_then(|d| format!("0.{}", d.trim()).parse::<f64>().ok()).unwrap_or(0.0);
    Some((((days * 24 + hour) * 60 + minute) * 60 + second) as f64 + fraction)
}

/// The first number of a field.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Rational(v) => v.first().map(|r| f64::from(r.num) / f64::from(r.denom)),
        Value::SRational(v) => v.first().map(|r| f64::from(r.num) / f64::from(r.denom)),
        Value::Float(v) => v.first().map(|&f| f64::from(f)),
        Value::Double(v) => v.first().copied(),
        other => other.get_uint(0).map(f64::from),
    }
}

fn text(value: &Value) -> Option<String> {
    let Value::Ascii(parts) = value else { return None };
    let joined = parts.iter().map(|p| String::from_utf8_lossy(p)).collect::<Vec<_>>().join(" ");
    let trimmed = joined.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    (!trimmed.is_empty()).then(|| trimmed.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::{Rational, SRational};

    fn facts(fields: &[(Tag, Value)]) -> Metadata {
        let field = |(tag, value): &(Tag, Value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() };
        let fields: Vec<Field> = fields.iter().map(field).collect();
        let mut metadata = Metadata::default();
        read_fields(&fields, &mut metadata);
        assert!(
            fields.iter().all(|f| TAGS.contains(&f.tag.number())),
            "every tag here is one that TIFF files are asked for"
        );
        metadata
    }

    fn ratio(num: u32, denom: u32) -> Value {
        Value::Rational(vec![Rational { num, denom }])
    }

    #[test]
    fn apex_values_stand_in_for_times_that_are_none() {
        let tv = (Tag::ShutterSpeedValue, Value::SRational(vec![SRational { num: 6, denom: 1 }]));
        for time in [ratio(0, 0), ratio(1, 0), ratio(0, 1), Value::Rational(Vec::new())] {
            assert_eq!(facts(&[(Tag::ExposureTime, time), tv.clone()]).exposure_secs, Some(1.0 / 64.0));
        }
        assert_eq!(facts(&[(Tag::ExposureTime, ratio(1, 50)), tv]).exposure_secs, Some(0.02));
        assert_eq!(facts(&[(Tag::ExposureTime, ratio(0, 0))]).exposure_secs, None);
        let found = facts(&[(Tag::FNumber, ratio(0, 0)), (Tag::ApertureValue, ratio(4, 1))]);
        assert_eq!(found.f_number, Some(4.0));
    }

    #[test]
    fn speeds_beyond_16_bits_are_in_another_tag() {
        let short = |v: u16| Value::Short(vec![v]);
        let speed = |v: u16| (Tag::PhotographicSensitivity, short(v));
        let index = (Tag::RecommendedExposureIndex, Value::Long(vec![102_400]));
        assert_eq!(facts(&[speed(65535), index.clone()]).iso, Some(102_400.0));
        assert_eq!(facts(&[speed(0), index.clone()]).iso, Some(102_400.0));
        assert_eq!(facts(&[speed(400), index]).iso, Some(400.0));
        assert_eq!(facts(&[speed(65535)]).iso, Some(65535.0));
        assert_eq!(facts(&[(Tag::ISOSpeed, Value::Long(vec![800]))]).iso, Some(800.0));
        // The first of several.
        assert_eq!(facts(&[(Tag::PhotographicSensitivity, Value::Short(vec![200, 0]))]).iso, Some(200.0));
    }

    #[test]
    fn moments_follow_each_other_across_days_months_and_years() {
        let at = |t: &str| seconds(t, None).unwrap();
        assert_eq!(at("2024:03:01 00:00:01") - at("2024:02:29 23:59:59"), 2.0);
        assert_eq!(at("2025:03:01 00:00:00") - at("2025:02:28 23:59:59"), 1.0);
        assert_eq!(at("2026:01:01 00:00:00") - at("2025:12:31 23:59:30"), 30.0);
        assert!((seconds("2026:01:01 00:00:00", Some("25")).unwrap() - at("2026:01:01 00:00:00") - 0.25).abs() < 1e-6);
        for bad in ["", "0000:00:00 00:00:00", "2024:13:01 00:00:00", "    :  :     :  :  ", "soon"] {
            assert_eq!(seconds(bad, None), None, "{bad}");
        }
    }
}
