//! A tree of many lamps. A walk from the root to a leaf chooses a lamp, nearly in proportion to its unblocked light at
//! a patch.
//!
//! At each node the walk chooses one of two children by power over squared distance, and by bounds of the cosines at
//! both ends (Conty Estévez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", 2018). A
//! share of all choices follows power alone, so that no bound can exclude a lamp.

use glam::DVec3;

use super::Constants;

/// A node: a ball around the lamps below it, and a cone of their normals.
#[derive(Debug, Clone)]
struct Node {
    centre: DVec3,
    radius: f64,
    power: f64,
    axis: DVec3,
    /// Cosine and sine of the angle between the axis and the farthest normal.
    cone: [f64; 2],
    /// The second child, if there is one. The first child is the next node.
    second: u32,
    /// The lamp of a leaf.
    lamp: u32,
    parent: u32,
}

#[derive(Debug, Clone)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// The leaf of each lamp.
    leaves: Vec<u32>,
    /// Cumulative power of the lamps, as a share of the total.
    cumulative: Vec<f64>,
}

const NONE: u32 = u32::MAX;

/// A lamp to be added: its index, centre, radius, normal and power.
type Item = (u32, DVec3, f64, DVec3, f64);

impl Tree {
    /// Builds a tree of lamps with these corners, normals and powers.
    pub(super) fn new(lamps: impl Iterator<Item = ([DVec3; 3], DVec3, f64)>) -> Tree {
        let ball = |[a, b, c]: [DVec3; 3]| {
            let centre = (a + b + c) / 3.0;
            (centre, a.distance(centre).max(b.distance(centre)).max(c.distance(centre)))
        };
        let mut items: Vec<Item> = (0..)
            .zip(lamps)
            .map(|(k, (corners, normal, power))| {
                let (centre, radius) = ball(corners);
                (k, centre, radius, normal, power)
            })
            .collect();
        let total: f64 = items.iter().map(|item| item.4).sum();
        let mut sum = 0.0;
        let cumulative = items
            .iter()
            .map(|item| {
                sum += item.4 / total;
                sum
            })
            .collect();
        let mut tree = Tree { nodes: Vec::new(), leaves: vec![0; items.len()], cumulative };
        tree.build(&mut items, NONE);
        tree
    }

    /// Builds a node, and divides its lamps in halves along the longest side of the box around their centres.
    fn build(&mut self, items: &mut [Item], parent: u32) -> u32 {
        let at = self.nodes.len() as u32;
        let bounds = |f: fn(DVec3, DVec3) -> DVec3| items.iter().map(|item| item.1).reduce(f);
        let (low, high) = (bounds(DVec3::min).unwrap_or_default(), bounds(DVec3::max).unwrap_or_default());
        let centre = 0.5 * (low + high);
        let normals: DVec3 = items.iter().map(|item| item.4 * item.3).sum();
        let axis = normals.normalize_or_zero();
        let cosine = match axis == DVec3::ZERO {
            true => -1.0,
            false => items.iter().map(|item| item.3.dot(axis)).fold(1.0, f64::min),
        };
        self.nodes.push(Node {
            centre,
            radius: items.iter().map(|item| item.1.distance(centre) + item.2).fold(0.0, f64::max),
            power: items.iter().map(|item| item.4).sum(),
            axis,
            cone: with_sine(cosine),
            second: NONE,
            lamp: items[0].0,
            parent,
        });
        if items.len() == 1 {
            self.leaves[items[0].0 as usize] = at;
            return at;
        }
        let extent = high - low;
        let along = if extent.x >= extent.y && extent.x >= extent.z {
            0
        } else if extent.y >= extent.z {
            1
        } else {
            2
        };
        items.sort_by(|a, b| a.1[along].total_cmp(&b.1[along]).then(a.0.cmp(&b.0)));
        let (first, second) = items.split_at_mut(items.len() / 2);
        self.build(first, at);
        let second = self.build(second, at);
        self.nodes[at as usize].second = second;
        at
    }

    /// Approximate unblocked light of a node's lamps at a patch, which is given as a ball and a normal.
    fn importance(&self, node: u32, (middle, radius, normal): (DVec3, f64, DVec3)) -> f64 {
        let node = &self.nodes[node as usize];
        let path = node.centre - middle;
        let (distance, size) = (path.length(), node.radius + radius);
        // All paths are within this angle of the direction between the centres.
        let spread = match distance > size {
            true => [(1.0 - (size / distance).powi(2)).sqrt(), size / distance],
            false => [-1.0, 0.0],
        };
        let direction = path / distance.max(f64::MIN_POSITIVE);
        let at_lamp = less(less(with_sine(-direction.dot(node.axis)), node.cone), spread)[0].max(0.0);
        let at_patch = less(with_sine(direction.dot(normal)), spread)[0].max(0.0);
        node.power * at_lamp * at_patch / distance.max(0.5 * size).powi(2).max(f64::MIN_POSITIVE)
    }

    /// The probability that a walk goes from a node to its first child.
    fn first(&self, at: u32, patch: (DVec3, f64, DVec3)) -> f64 {
        let (first, second) = (at + 1, self.nodes[at as usize].second);
        let [a, b] = [first, second].map(|child| self.importance(child, patch));
        if a + b > 0.0 {
            return a / (a + b);
        }
        let [a, b] = [first, second].map(|child| self.nodes[child as usize].power);
        a / (a + b)
    }

    /// Chooses a lamp with a number in \[0, 1). Also returns the rest of the number, stretched to \[0, 1) again, and
    /// the probability of the lamp.
    pub(super) fn choose(&self, patch: (DVec3, f64, DVec3), u: f64) -> (usize, f64, f64) {
        let by_power = Constants::BY_POWER;
        if u < by_power {
            let u = u / by_power;
            let k = self.cumulative.partition_point(|&c| c <= u).min(self.cumulative.len() - 1);
            let below = if k > 0 { self.cumulative[k - 1] } else { 0.0 };
            let share = self.cumulative[k] - below;
            let mut walked = 1.0;
            let mut at = self.leaves[k];
            while self.nodes[at as usize].parent != NONE {
                let parent = self.nodes[at as usize].parent;
                let first = self.first(parent, patch);
                walked *= if at == parent + 1 { first } else { 1.0 - first };
                at = parent;
            }
            return (k, (u - below) / share, by_power * share + (1.0 - by_power) * walked);
        }
        let (mut u, mut at, mut walked) = ((u - by_power) / (1.0 - by_power), 0, 1.0);
        while self.nodes[at as usize].second != NONE {
            let first = self.first(at, patch);
            if u < first {
                (u, walked, at) = (u / first, walked * first, at + 1);
            } else {
                let rest = 1.0 - first;
                (u, walked, at) = ((u - first) / rest, walked * rest, self.nodes[at as usize].second);
            }
        }
        let k = self.nodes[at as usize].lamp as usize;
        let share = self.cumulative[k] - if k > 0 { self.cumulative[k - 1] } else { 0.0 };
        (k, u, by_power * share + (1.0 - by_power) * walked)
    }
}

/// An angle between 0 and π as its cosine and sine.
fn with_sine(cosine: f64) -> [f64; 2] {
    let cosine = cosine.clamp(-1.0, 1.0);
    [cosine, (1.0 - cosine * cosine).sqrt()]
}

/// The difference of two angles, or 0 if it is negative. Angles are given by cosine and sine: a walk needs dozens of
/// them, and inverse trigonometric functions took half of its time.
fn less([cos_a, sin_a]: [f64; 2], [cos_b, sin_b]: [f64; 2]) -> [f64; 2] {
    if cos_a >= cos_b {
        return [1.0, 0.0];
    }
    [cos_a * cos_b + sin_a * sin_b, sin_a * cos_b - cos_a * sin_b]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    /// Probabilities sum to one over all lamps, and equal the frequencies of choices.
    #[test]
    fn probabilities_sum_to_one() {
        let lamp = |k: usize| {
            let at = dvec3((k % 7) as f64, (k % 5) as f64, (k % 3) as f64);
            let normal = dvec3(0.3, (k % 4) as f64 - 1.5, -1.0).normalize();
            ([at, at + DVec3::X * 0.3, at + DVec3::Y * 0.3], normal, 1.0 + (k % 6) as f64)
        };
        let tree = Tree::new((0..105).map(lamp));
        let patch = (dvec3(2.0, 2.0, -1.0), 0.2, DVec3::Z);
        let (mut found, mut probability) = ([0.0; 105], [0.0; 105]);
        let count = 200_000;
        for k in 0..count {
            let (lamp, rest, p) = tree.choose(patch, (f64::from(k) + 0.5) / f64::from(count));
            assert!((0.0..=1.0).contains(&rest));
            found[lamp] += 1.0 / f64::from(count);
            probability[lamp] = p;
        }
        assert!((probability.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{}", probability.iter().sum::<f64>());
        for (found, p) in found.iter().zip(probability) {
            assert!((found - p).abs() < 1e-4, "{found} for {p}");
        }
    }
}
