//! Warnings of readers about omissions and assumptions. Many similar warnings become one sentence.

use std::collections::HashMap;

/// If a kind has more cases than this, one sentence names the first cases and counts the others.
const MOST: usize = 3;

/// Warnings, in the order of their first occurrence.
#[derive(Default)]
pub(super) struct Warnings {
    kinds: Vec<Kind>,
    /// Index of each kind in `kinds`. The key is the words before and after the name.
    known: HashMap<(String, String), usize>,
}

enum Kind {
    Plain(String),
    Repeated {
        before: String,
        after: String,
        /// Place and name of each case.
        cases: Vec<(String, String)>,
    },
}

impl Warnings {
    /// Adds a sentence.
    pub(super) fn push(&mut self, sentence: String) {
        self.kinds.push(Kind::Plain(sentence));
    }

    /// Adds the sentence ``place: before `name`after``. Sentences that differ only in place and name are one kind.
    pub(super) fn repeat(&mut self, place: String, before: &str, name: &str, after: &str) {
        let next = self.kinds.len();
        let at = *self.known.entry((before.into(), after.into())).or_insert(next);
        if at == next {
            self.kinds.push(Kind::Repeated { before: before.into(), after: after.into(), cases: Vec::new() });
        }
        if let Kind::Repeated { cases, .. } = &mut self.kinds[at] {
            cases.push((place, name.into()));
        }
    }

    /// Adds all of `others`.
    pub(super) fn append(&mut self, others: Warnings) {
        for kind in others.kinds {
            match kind {
                Kind::Plain(sentence) => self.push(sentence),
                Kind::Repeated { before, after, cases } => {
                    cases.into_iter().for_each(|(place, name)| self.repeat(place, &before, &name, &after));
                }
            }
        }
    }

    /// The sentences.
    pub(super) fn into_sentences(self) -> Vec<String> {
        let mut sentences = Vec::new();
        for kind in self.kinds {
            match kind {
                Kind::Plain(sentence) => sentences.push(sentence),
                Kind::Repeated { before, after, cases } => {
                    let sentence =
                        |(place, name): &(String, String)| format!("{place}: {before} `{name}`{after}");
                    if cases.len() <= MOST {
                        sentences.extend(cases.iter().map(sentence));
                    } else {
                        let next: Vec<String> =
                            cases[1..MOST].iter().map(|(_, name)| format!("`{name}`")).collect();
                        sentences.push(format!(
                            "{}; the same of {} and {} more",
                            sentence(&cases[0]),
                            next.join(", "),
                            cases.len() - MOST
                        ));
                    }
                }
            }
        }
        sentences
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_have_a_sentence_each_and_many_share_one() {
        let mut warnings = Warnings::default();
        for name in ["a", "b", "c"] {
            warnings.repeat(format!("{name}.mtl"), "texture", name, " not found");
        }
        warnings.push("plain".into());
        let mut more = Warnings::default();
        for k in 0..5 {
            more.repeat(format!("m:{k}"), "material", &k.to_string(), " is odd");
        }
        warnings.append(more);
        assert_eq!(
            warnings.into_sentences(),
            [
                "a.mtl: texture `a` not found",
                "b.mtl: texture `b` not found",
                "c.mtl: texture `c` not found",
                "plain",
                "m:0: material `0` is odd; the same of `1`, `2` and 2 more",
            ]
        );
    }
}
