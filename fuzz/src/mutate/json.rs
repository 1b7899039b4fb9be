//! Mutations of JSON that keep it JSON: another value in a place, lists that grow and shrink, members that go.

use super::{below, pick};
use serde_json::{Value, json};
use translume_core::rng::Pcg32;

/// Changes a document in one place; false when it is none.
pub(super) fn mutate(bytes: &mut Vec<u8>, rng: &mut Pcg32) -> bool {
    let Ok(mut document) = serde_json::from_slice::<Value>(bytes) else { return false };
    let (count, other) = (nodes(&document), document.clone());
    let donor = nth(&other, &mut below(count, rng)).cloned().unwrap_or_default();
    let mut at = 1 + below(count.saturating_sub(1), rng);
    change(&mut document, &mut at, &donor, rng);
    *bytes = document.to_string().into_bytes();
    true
}

fn nodes(v: &Value) -> usize {
    1 + match v {
        Value::Array(list) => list.iter().map(nodes).sum::<usize>(),
        Value::Object(map) => map.values().map(nodes).sum(),
        _ => 0,
    }
}

fn children(v: &Value) -> Vec<&Value> {
    match v {
        Value::Array(list) => list.iter().collect(),
        Value::Object(map) => map.values().collect(),
        _ => Vec::new(),
    }
}

fn nth<'a>(v: &'a Value, n: &mut usize) -> Option<&'a Value> {
    if *n == 0 {
        return Some(v);
    }
    *n -= 1;
    children(v).into_iter().find_map(|c| nth(c, n))
}

/// Changes the node that is `n` away in order; whether it was met.
fn change(v: &mut Value, n: &mut usize, donor: &Value, rng: &mut Pcg32) -> bool {
    if *n == 0 {
        replace(v, donor, rng);
        return true;
    }
    *n -= 1;
    match v {
        Value::Array(list) => {
            for i in 0..list.len() {
                if *n == 0 && below(3, rng) == 0 {
                    if below(2, rng) == 0 {
                        list.remove(i);
                    } else {
                        list.insert(i, list[i].clone());
                    }
                    return true;
                }
                if change(&mut list[i], n, donor, rng) {
                    return true;
                }
            }
            false
        }
        Value::Object(map) => {
            let keys: Vec<String> = map.keys().cloned().collect();
            keys.iter().any(|key| {
                if *n == 0 && below(4, rng) == 0 {
                    return map.remove(key).is_some();
                }
                map.get_mut(key).is_some_and(|child| change(child, n, donor, rng))
            })
        }
        _ => false,
    }
}

fn replace(v: &mut Value, donor: &Value, rng: &mut Pcg32) {
    if below(5, rng) == 0 {
        *v = donor.clone();
        return;
    }
    *v = match v {
        Value::Number(n) => {
            let x = n.as_f64().unwrap_or(0.0);
            match below(6, rng) {
                0 => json!((x as i64).saturating_add(1)),
                1 => json!((x as i64).saturating_sub(1)),
                2 => json!(-x),
                3 => json!(x * 1e6),
                _ => pick(
                    &[
                        json!(0),
                        json!(1),
                        json!(-1),
                        json!(2),
                        json!(255),
                        json!(65536),
                        json!(2_147_483_647),
                        json!(4_294_967_295u32),
                        json!(u64::MAX),
                        json!(i64::MIN),
                        json!(1e38),
                        json!(1e300),
                        json!(-1e38),
                        json!(1e-300),
                        json!(0.5),
                        json!(5126),
                        json!(5121),
                    ],
                    rng,
                )
                .clone(),
            }
        }
        Value::String(s) => match below(5, rng) {
            0 => json!(""),
            1 => json!(s.repeat(3)),
            2 => json!(s.to_uppercase()),
            3 => json!(format!("{s}/../{s}")),
            _ => json!(s.chars().rev().collect::<String>()),
        },
        Value::Array(list) => match below(4, rng) {
            0 => json!([]),
            1 => Value::Array(list.iter().cycle().take(2 * list.len()).cloned().collect()),
            2 => Value::Array(list.iter().rev().cloned().collect()),
            _ => Value::Array(list.iter().cycle().take((50 * list.len()).min(2000)).cloned().collect()),
        },
        Value::Bool(b) => json!(!*b),
        _ => pick(&[json!(null), json!({}), json!([]), json!(0), json!("x")], rng).clone(),
    };
}
