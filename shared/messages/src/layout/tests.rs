//! Layouts: fingerprints tell structs apart, and walks see every field.

use super::*;
use crate::content::State;
use crate::header::Header;

const A: Field = Field {
    name: "a",
    offset: 0,
    size: 8,
    kind: Kind::U64,
    length: None,
};
const B: Field = Field {
    name: "b",
    offset: 8,
    ..A
};

#[test]
fn swapped_renamed_or_resized_fields_change_the_fingerprint() {
    let known = fingerprint(&[A, B]);
    let swapped = [Field { offset: 0, ..B }, Field { offset: 8, ..A }];
    let renamed = [A, Field { name: "c", ..B }];
    let resized = [A, Field { size: 4, ..B }];
    let number = [
        A,
        Field {
            kind: Kind::F64,
            ..B
        },
    ];
    for other in [swapped, renamed, resized, number] {
        assert_ne!(fingerprint(&other), known);
    }
}

#[test]
fn a_struct_within_is_known_by_its_fields_and_not_by_its_name_alone() {
    const fn holder(fields: &'static [Field]) -> [Field; 1] {
        [Field {
            name: "grants",
            offset: 0,
            size: 16,
            kind: Kind::Struct {
                name: "Grants",
                fields,
            },
            length: None,
        }]
    }
    const SWAPPED: [Field; 2] = [Field { offset: 0, ..B }, Field { offset: 8, ..A }];
    assert_ne!(
        fingerprint(&holder(&[A, B])),
        fingerprint(&holder(&SWAPPED))
    );
}

#[test]
fn every_field_is_visited_in_order_with_its_values() {
    #[derive(Default)]
    struct Seen(Vec<(&'static str, Vec<f64>)>);
    impl Visitor for Seen {
        fn integers(&mut self, field: &'static Field, values: &[u64]) {
            self.0.push((
                field.name,
                values.iter().map(|value| *value as f64).collect(),
            ));
        }
        fn numbers(&mut self, field: &'static Field, values: &[f64]) {
            self.0.push((field.name, values.to_vec()));
        }
        fn structs<L: Visit>(&mut self, field: &'static Field, values: &[L]) {
            self.0.push((field.name, Vec::new()));
            values.iter().for_each(|value| value.visit(self));
        }
    }
    let mut envelope = Header {
        tick: 7,
        input_tick: [5, 6, 7],
        ..Header::new()
    };
    envelope.stamps[2].send_ns = 9;
    let mut seen = Seen::default();
    envelope.visit(&mut seen);
    let names: Vec<_> = Header::FIELDS.iter().map(|field| field.name).collect();
    let of = |name: &str| -> Vec<Vec<f64>> {
        seen.0
            .iter()
            .filter(|(seen, _)| *seen == name)
            .map(|(_, values)| values.clone())
            .collect()
    };
    assert!(names.iter().all(|name| of(name).len() == 1), "{:?}", seen.0);
    assert_eq!(of("tick"), [[7.0]]);
    assert_eq!(of("input_tick"), [[5.0, 6.0, 7.0]]);
    assert_eq!(of("send_ns"), [[0.0], [0.0], [9.0], [0.0]]);
    let stamps = Header::FIELDS
        .iter()
        .find(|field| field.name == "stamps")
        .unwrap();
    assert!(matches!(stamps.kind, Kind::Struct { name: "Stamps", fields } if fields.len() == 2));
    assert_eq!(stamps.length, Some(4));
}

#[test]
fn gaps_are_seen() {
    assert!(is_dense(&[A, B], 16));
    assert!(!is_dense(&[A, B], 24));
    assert!(!is_dense(&[A, Field { offset: 12, ..B }], 20));
}

#[test]
fn what_differs_in_one_bit_is_not_the_same() {
    /// Changes the sign or the highest bit of a word, the one after so many.
    struct Flip(usize);
    impl Flip {
        fn is_due(&mut self) -> bool {
            self.0 = self.0.wrapping_sub(1);
            self.0 == usize::MAX
        }
    }
    impl VisitorMut for Flip {
        fn integers(&mut self, _: &'static Field, values: &mut [u64]) {
            values
                .iter_mut()
                .filter(|_| self.is_due())
                .for_each(|value| *value ^= 1 << 63);
        }
        fn numbers(&mut self, _: &'static Field, values: &mut [f64]) {
            values
                .iter_mut()
                .filter(|_| self.is_due())
                .for_each(|value| *value = -*value);
        }
        fn structs<L: Visit>(&mut self, _: &'static Field, values: &mut [L]) {
            values.iter_mut().for_each(|value| value.visit_mut(self));
        }
    }
    let mut state = State::default();
    assert!(state.is_same(&state));
    for word in 0..size_of::<State>() / size_of::<u64>() {
        let mut other = state;
        other.visit_mut(&mut Flip(word));
        // Zeros of either sign are equal.
        assert!(!state.is_same(&other), "word {word}");
    }
    state.truth.parameter[1] = f64::NAN;
    assert!(state.is_same(&state), "no number is the same as itself");
}
