//! Several rays on their way at a time: while one waits for memory, the others go on.
//!
//! What a ray visits next depends on what it has just read. In a hierarchy beyond the nearest caches it waits there, and alone it
//! waits for most of its time. Rays that do not depend on each other take turns instead, a node or leaf each, and find what
//! they come to fetched meanwhile.

use std::mem::MaybeUninit;

use glam::Vec3A;

use super::{
    bvh::{Bvh, STACK, Way},
    query::Query,
    watertight::PreparedRay,
    wide::Lanes,
};

/// Rays on their way at a time. Of a million triangles 4, 8 and 12 took a half, a third and a quarter of the time that one ray after
/// the other takes.
const FLIGHTS: usize = 12;
/// Hierarchies up to so many bytes stay in a near cache: there rays go one after the other, since taking turns costs time as well.
const NEAR: usize = 1 << 20;

/// A ray on its way, and what its caller knows it by.
struct Flight<'a, T, Q> {
    name: T,
    ray: PreparedRay,
    way: Way<'a>,
    query: Q,
}

impl Bvh {
    /// Asks rays with a name, an origin and a direction each, and calls `answered` with the name of each and its answer, in the
    /// order in which they end. That depends on the rays alone.
    #[inline(always)]
    pub(super) fn ask_each<L: Lanes, Q: Query, T>(
        &self,
        lanes: L,
        rays: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
        mut answered: impl FnMut(T, Q::Answer),
    ) {
        let mut rays = rays.into_iter();
        if self.bytes() <= NEAR {
            for (name, origin, direction) in rays {
                answered(name, self.ask::<L, Q>(lanes, &PreparedRay::new(origin, direction)));
            }
            return;
        }
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
                // In place, since moving a flight takes as long as a step.
                let answer = std::mem::take(&mut flight.query).answer();
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
