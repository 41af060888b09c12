//! Casts several rays at a time: while one waits for memory, the others proceed.
//!
//! The next node of a ray depends on the node it has just read. In a hierarchy larger than the nearest caches, a single
//! ray waits for memory most of the time. Independent rays therefore take turns, one node or leaf each, and meanwhile
//! the next nodes of the others are fetched.

use std::mem::MaybeUninit;

use glam::Vec3A;

use super::{
    bvh::{Bvh, STACK, Way},
    query::Query,
    watertight::PreparedRay,
    wide::Lanes,
};

/// Number of rays at a time. With a million triangles, 4, 8 and 12 take a half, a third and a quarter of the time of
/// rays cast one by one.
const FLIGHTS: usize = 12;
/// A hierarchy up to this number of bytes stays in a near cache. Rays are then cast one by one, because turns cost time
/// too.
const NEAR: usize = 1 << 20;

/// A ray on its way, with the name that its caller gave it.
struct Flight<'a, T, Q> {
    name: T,
    ray: PreparedRay,
    way: Way<'a>,
    query: Q,
}

impl Bvh {
    /// Casts rays. Each has a name, an origin and a direction. Calls `answered` with the name of a ray and its answer,
    /// in the order in which rays end. This order depends on the rays alone.
    #[inline(always)]
    pub(super) fn ask_each<L: Lanes, Q: Query, T>(
        &self,
        lanes: L,
        rays: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
        mut answered: impl FnMut(T, Q::Answer),
    ) {
        if self.bytes() > NEAR {
            return self.take_turns::<L, Q, T>(lanes, rays.into_iter(), answered);
        }
        for (name, origin, direction) in rays {
            answered(name, self.ask::<L, Q>(lanes, &PreparedRay::new(origin, direction)));
        }
    }

    #[inline(always)]
    fn take_turns<L: Lanes, Q: Query, T>(
        &self,
        lanes: L,
        mut rays: impl Iterator<Item = (T, Vec3A, Vec3A)>,
        mut answered: impl FnMut(T, Q::Answer),
    ) {
        let mut room = [MaybeUninit::uninit(); FLIGHTS * STACK];
        let mut large = Vec::new();
        let mut room = &mut room[..];
        if self.stack() > STACK {
            large.resize(FLIGHTS * self.stack(), MaybeUninit::uninit());
            room = &mut large;
        }
        let mut rooms = room.chunks_exact_mut(self.stack().max(STACK));
        let mut flights: [Option<Flight<T, Q>>; FLIGHTS] = std::array::from_fn(|_| {
            let (name, origin, direction) = rays.next()?;
            let ray = PreparedRay::new(origin, direction);
            let way = Way::begin::<Q>(rooms.next()?, &ray);
            Some(Flight { name, ray, way, query: Q::default() })
        });
        let mut flying = flights.iter().flatten().count();
        while flying > 0 {
            for slot in &mut flights {
                let Some(flight) = slot else { continue };
                if self.step(lanes, &flight.ray, &mut flight.way, &mut flight.query) {
                    continue;
                }
                // In place: moving a flight takes as long as a step.
                let query = std::mem::take(&mut flight.query);
                let answer = query.answer(|met| self.rounding(&flight.ray, met));
                if let Some((name, origin, direction)) = rays.next() {
                    flight.ray = PreparedRay::new(origin, direction);
                    flight.way.begin_anew::<Q>(&flight.ray);
                    answered(std::mem::replace(&mut flight.name, name), answer);
                } else if let Some(ended) = slot.take() {
                    answered(ended.name, answer);
                    flying -= 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{
        Tracer,
        query::{Free, Nearest},
        wide::{
            Kernel, Portable,
            tests::{Random, soup, tracer},
        },
    };

    /// For each ray, cast in turns, its hit and whether it is free.
    fn in_turns(tracer: &Tracer, rays: &[(Vec3A, Vec3A)]) -> Vec<[Option<(u32, u32)>; 2]> {
        let mut found = vec![[Some((u32::MAX, 0)); 2]; rays.len()];
        let named = || rays.iter().enumerate().map(|(k, &(from, to))| (k, from, to - from));
        tracer.bvh.take_turns::<_, Nearest, _>(Portable, named(), |k, met| {
            assert_eq!(found[k][0], Some((u32::MAX, 0)), "answered twice");
            found[k][0] = met.map(|met| (met.triangle, met.t.to_bits()));
        });
        tracer.bvh.take_turns::<_, Free, _>(Portable, named(), |k, free| {
            assert_eq!(found[k][1], Some((u32::MAX, 0)), "answered twice");
            found[k][1] = free.then_some((0, 0));
        });
        found
    }

    fn one_by_one(tracer: &Tracer, rays: &[(Vec3A, Vec3A)]) -> Vec<[Option<(u32, u32)>; 2]> {
        let ask = |&(from, to): &(Vec3A, Vec3A)| {
            let met = tracer.closest(from, to - from);
            [
                met.map(|hit| (hit.triangle, hit.t.to_bits())),
                tracer.kernel.ask::<Free>(&tracer.bvh, from, to - from).then_some((0, 0)),
            ]
        };
        rays.iter().map(ask).collect()
    }

    /// Ordinary and degenerate rays.
    fn some_rays(count: usize, random: &mut Random) -> Vec<(Vec3A, Vec3A)> {
        let ray = |k: usize| match k % 4 {
            0 => (random.odd_vector(), random.odd_vector()),
            _ => (random.point().as_vec3a(), random.point().as_vec3a()),
        };
        (0..count).map(ray).collect()
    }

    #[test]
    fn rays_in_turns_end_where_each_alone_does() {
        for triangles in [0, 1, 9, if cfg!(miri) { 20 } else { 3000 }] {
            let mut random = Random(triangles as u64);
            let tracer = tracer(&soup(triangles, &mut random));
            for count in [0, 1, FLIGHTS - 1, FLIGHTS, FLIGHTS + 1, if cfg!(miri) { 30 } else { 3000 }] {
                let rays = some_rays(count, &mut random);
                assert_eq!(in_turns(&tracer, &rays), one_by_one(&tracer, &rays), "{triangles} {count}");
            }
        }
    }

    /// The order in which rays end is the same with and without wide instructions, if they take turns.
    #[test]
    #[cfg_attr(miri, ignore = "too many triangles")]
    fn rays_end_in_one_order() {
        let mut random = Random(5);
        let tracer = tracer(&soup(30_000, &mut random));
        assert!(tracer.bvh.bytes() > NEAR);
        let rays = some_rays(3000, &mut random);
        let [wide, plain] = [Kernel::detect(), Kernel::Portable].map(|kernel| {
            let mut ended = Vec::new();
            let named = rays.iter().enumerate().map(|(k, &(from, to))| (k, from, to - from));
            kernel.ask_each::<Nearest, _>(&tracer.bvh, named, |k, met| {
                ended.push((k, met.map(|met| (met.triangle, met.t.to_bits()))));
            });
            ended
        });
        assert_eq!(wide, plain);
        assert!(!wide.is_sorted_by_key(|(k, _)| *k), "they did not take turns");
    }
}
