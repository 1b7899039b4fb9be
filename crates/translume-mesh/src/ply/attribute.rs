//! Properties by their names, beside what [`read`](super::read) makes of a file.

use super::{Element, Parsed, Property, Source, broken, header, skip, skip_property};
use crate::error::Result;
use std::path::Path;

/// The properties NAME_0, NAME_1, … of the records of `element` as they are stored, one number (three times) or three a
/// record; `None` where there are not as many. `path` is for messages.
///
/// # Errors
/// As [`super::read`].
pub fn attribute(path: &Path, bytes: &[u8], element: &str, name: &str) -> Result<Option<Vec<[f32; 3]>>> {
    find(bytes, element, name).map_err(|fault| fault.at(path))
}

fn find(bytes: &[u8], wanted: &str, name: &str) -> Parsed<Option<Vec<[f32; 3]>>> {
    // Of the header's odd lines the mesh reader has warned.
    let (encoding, elements, body) = header(bytes, &mut Vec::new())?;
    let mut source = Source::new(encoding, &elements, body);
    for element in &elements {
        source.check_room(element)?;
        if element.name == wanted {
            return values(&mut source, element, name);
        }
        skip(&mut source, element)?;
    }
    Ok(None)
}

fn values(source: &mut Source, element: &Element, name: &str) -> Parsed<Option<Vec<[f32; 3]>>> {
    let slot = |p: &Property| {
        let number = p.name.strip_prefix(name)?.strip_prefix('_')?.parse::<usize>().ok()?;
        (p.length.is_none() && number < 3).then_some(number)
    };
    let slots: Vec<Option<usize>> = element.properties.iter().map(slot).collect();
    let channels = slots.iter().flatten().count();
    if channels != 1 && channels != 3 {
        return Ok(None);
    }
    let mut values = Vec::with_capacity(element.count as usize); // bounded by check_room
    for record in 0..element.count {
        let mut value = [0.0; 3];
        for (p, slot) in element.properties.iter().zip(&slots) {
            match slot {
                Some(slot) => source.value(p.kind).map(|v| value[*slot] = v as f32),
                None => skip_property(source, p),
            }
            .ok_or_else(|| broken(element, record))?;
        }
        source.end_record();
        values.push(if channels == 1 { [value[0]; 3] } else { value });
    }
    Ok(Some(values))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn properties_are_found_as_the_mesh_reader_reads_them() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty list uchar int64 odd\nproperty double heat_0\nproperty \
                    float tint_0\nproperty float tint_1\nproperty float tint_2\nelement face 1\nproperty short part_0\n\
                    end_header\n2 7 8 0.5 1 2 3 surplus\n0 0.25 4 5 6\n-9\n";
        for text in [text.to_owned(), text.replace('\n', "\r\n"), text.replace('\n', "\r")] {
            let of = |element: &str, name: &str| attribute(Path::new("a.ply"), text.as_bytes(), element, name).unwrap();
            assert_eq!(of("vertex", "heat"), Some(vec![[0.5; 3], [0.25; 3]]));
            assert_eq!(of("vertex", "tint"), Some(vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
            assert_eq!(of("face", "part"), Some(vec![[-9.0; 3]]));
            assert_eq!((of("face", "tint"), of("edge", "part"), of("vertex", "odd")), (None, None, None));
        }
        assert!(attribute(Path::new("a.ply"), &text.as_bytes()[..text.len() - 3], "face", "part").is_err());
    }
}
