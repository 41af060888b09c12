//! Processes that share out one computation: the ranks of an MPI job.
//!
//! Every rank has the whole scene and whole vectors with a value for each patch. It computes its share of the values,
//! and [`Ranks::share`] brings the shares of all ranks to all of them. No sum has an order that depends on the number of
//! ranks: all terms of a value are added by the rank that owns the value. So any number of ranks gives the same bytes.
//!
//! All ranks must call the functions that share values in the same order. So nothing that differs between them, such as a
//! clock, may decide what is computed next.
//!
//! Without the feature `mpi` there is one rank, and nothing here does anything.

use std::{
    ops::Range,
    sync::{
        OnceLock,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

use crate::{Error, Result};

/// The ranks of this process's job.
static WORLD: OnceLock<Ranks> = OnceLock::new();

/// Bytes that all ranks sent, if each sends its values once to each other rank.
static SENT: AtomicU64 = AtomicU64::new(0);

/// A rank and the number of ranks that share out a computation with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ranks {
    rank: usize,
    count: usize,
    /// Number of ranks on the machine of this one.
    on_this_machine: usize,
}

impl Default for Ranks {
    /// See [`Ranks::alone`].
    fn default() -> Self {
        Ranks::alone()
    }
}

/// Ends the connection to the other ranks when it is dropped.
#[derive(Default)]
pub struct Connection {
    #[cfg(feature = "mpi")]
    _universe: Option<mpi::environment::Universe>,
}

impl Ranks {
    /// One process without others.
    pub const fn alone() -> Ranks {
        Ranks { rank: 0, count: 1, on_this_machine: 1 }
    }

    /// Connects this process with the other processes of its MPI job. Call it once, before any other work.
    ///
    /// # Errors
    /// [`Error::Usage`] when `mpirun` started several processes and the feature `mpi` is missing, or when the MPI library
    /// permits calls from one thread only.
    #[cfg(not(feature = "mpi"))]
    pub fn connect() -> Result<Connection> {
        let several = |name: &str| std::env::var(name).is_ok_and(|n| n.parse().is_ok_and(|n: u32| n > 1));
        // Open MPI, and MPICH with its descendants.
        if several("OMPI_COMM_WORLD_SIZE") || several("PMI_SIZE") {
            return Err(Error::Usage {
                message: "this program was built without MPI, and an MPI launcher started several of it"
                    .into(),
                hint: Some("build it with the feature `mpi`".into()),
            });
        }
        Ok(Connection::default())
    }

    /// Connects this process with the other processes of its MPI job. Call it once, before any other work.
    ///
    /// # Errors
    /// [`Error::Usage`] when `mpirun` started several processes and the feature `mpi` is missing, or when the MPI library
    /// permits calls from one thread only.
    #[cfg(feature = "mpi")]
    pub fn connect() -> Result<Connection> {
        use mpi::{Threading, topology::SimpleCommunicator, traits::Communicator};

        // Threads take turns in calling MPI.
        let Some((universe, provided)) = mpi::initialize_with_threading(Threading::Serialized) else {
            return Ok(Connection::default());
        };
        let world = SimpleCommunicator::world();
        let [rank, count, on_this_machine] =
            [world.rank(), world.size(), world.split_shared(world.rank()).size()].map(|n| n as usize);
        let ranks = Ranks { rank, count, on_this_machine };
        if ranks.count > 1 && provided < Threading::Serialized {
            return Err(Error::Usage {
                message: "this MPI library permits calls from one thread only".into(),
                hint: Some("use a library with MPI_THREAD_SERIALIZED, as Open MPI and MPICH have".into()),
            });
        }
        let _ = WORLD.set(ranks);
        Ok(Connection { _universe: Some(universe) })
    }

    /// The ranks that [`Ranks::connect`] found; one if it was not called.
    pub fn world() -> Ranks {
        WORLD.get().copied().unwrap_or_default()
    }

    /// Number of this rank, from 0.
    pub fn rank(self) -> usize {
        self.rank
    }

    /// Number of ranks.
    pub fn count(self) -> usize {
        self.count
    }

    /// Number of ranks that share the memory of this machine.
    pub fn on_this_machine(self) -> usize {
        self.on_this_machine
    }

    /// Whether this is the rank that writes results.
    pub fn is_first(self) -> bool {
        self.rank == 0
    }

    /// Bytes that all ranks sent so far, if each sends its values once to each other rank.
    pub fn sent() -> u64 {
        SENT.load(Relaxed)
    }

    /// Ends the processes of all ranks, if there are several, with this exit status.
    pub fn abort(self, status: u8) {
        if self.count > 1 {
            #[cfg(feature = "mpi")]
            mpi::traits::Communicator::abort(&mpi::topology::SimpleCommunicator::world(), status.into());
            #[cfg(not(feature = "mpi"))]
            let _ = status;
        }
    }

    /// Waits until all ranks call this.
    pub fn wait(self) {
        self.values(0u32);
    }

    /// The value of every rank, in their order.
    pub(crate) fn values<T: Word>(self, value: T) -> Vec<T> {
        if self.count == 1 {
            return vec![value];
        }
        all_gather(&[value], &vec![1; self.count]).concat()
    }

    /// The sum over all ranks.
    pub(crate) fn sum(self, value: usize) -> usize {
        self.values(value as u64).into_iter().sum::<u64>() as usize
    }

    /// The largest value of any rank.
    pub(crate) fn max(self, value: f64) -> f64 {
        self.values(value).into_iter().fold(value, f64::max)
    }

    /// The rank that does the `k`th of many equal pieces of work, in turn.
    pub(crate) fn of_turn(self, k: usize) -> usize {
        k % self.count
    }

    /// Completes `values` on all ranks. Each of the `runs` is a range of values, and the rank that computed them. Other
    /// values stay as they are.
    pub(crate) fn share<V: Words>(
        self,
        values: &mut [V],
        runs: impl Iterator<Item = (Range<usize>, usize)> + Clone,
    ) {
        if self.count == 1 {
            return;
        }
        let mut lengths = vec![0; self.count];
        runs.clone().for_each(|(run, owner)| lengths[owner] += run.len() * V::COUNT);
        let mut own = Vec::with_capacity(lengths[self.rank]);
        for (run, _) in runs.clone().filter(|&(_, owner)| owner == self.rank) {
            values[run].iter().for_each(|value| own.extend_from_slice(value.words()));
        }
        let all = all_gather(&own, &lengths);
        drop(own);
        let mut next = vec![0; self.count];
        for (run, owner) in runs {
            let from = &mut next[owner];
            for value in &mut values[run] {
                value.words_mut().copy_from_slice(&all[owner][*from..*from + V::COUNT]);
                *from += V::COUNT;
            }
        }
    }
}

/// A number that ranks can send.
#[cfg(not(feature = "mpi"))]
pub(crate) trait Word: Copy + Default + Send + Sync {}
/// A number that ranks can send.
#[cfg(feature = "mpi")]
pub(crate) trait Word: Copy + Default + Send + Sync + mpi::traits::Equivalence {}

impl Word for u32 {}
impl Word for u64 {}
impl Word for f32 {}
impl Word for f64 {}

/// A value that consists of numbers.
pub(crate) trait Words {
    type Word: Word;
    const COUNT: usize;
    fn words(&self) -> &[Self::Word];
    fn words_mut(&mut self) -> &mut [Self::Word];
}

impl Words for u32 {
    type Word = u32;
    const COUNT: usize = 1;

    fn words(&self) -> &[u32] {
        std::slice::from_ref(self)
    }

    fn words_mut(&mut self) -> &mut [u32] {
        std::slice::from_mut(self)
    }
}

impl<T: Word, const N: usize> Words for [T; N] {
    type Word = T;
    const COUNT: usize = N;

    fn words(&self) -> &[T] {
        self
    }

    fn words_mut(&mut self) -> &mut [T] {
        self
    }
}

impl<T: Word, const N: usize, const M: usize> Words for [[T; N]; M] {
    type Word = T;
    const COUNT: usize = N * M;

    fn words(&self) -> &[T] {
        self.as_flattened()
    }

    fn words_mut(&mut self) -> &mut [T] {
        self.as_flattened_mut()
    }
}

impl<const M: usize> Words for nalgebra::SVector<f64, M> {
    type Word = f64;
    const COUNT: usize = M;

    fn words(&self) -> &[f64] {
        self.as_slice()
    }

    fn words_mut(&mut self) -> &mut [f64] {
        self.as_mut_slice()
    }
}

/// The words of every rank. `lengths` are their numbers.
#[cfg(feature = "mpi")]
fn all_gather<T: Word>(own: &[T], lengths: &[usize]) -> Vec<Vec<T>> {
    use mpi::{datatype::PartitionMut, topology::SimpleCommunicator, traits::CommunicatorCollectives};

    // MPI counts with 32 bits. Longer lists go in pieces.
    let most = (1 << 30) / lengths.len();
    let bytes = size_of::<T>() * lengths.iter().sum::<usize>() * (lengths.len() - 1);
    SENT.fetch_add(bytes as u64, Relaxed);
    let world = SimpleCommunicator::world();
    let mut all: Vec<Vec<T>> = lengths.iter().map(|&length| Vec::with_capacity(length)).collect();
    let longest = lengths.iter().copied().max().unwrap_or(0);
    for start in (0..longest).step_by(most) {
        let piece = |length: usize| start.min(length)..(start + most).min(length);
        let counts: Vec<i32> = lengths.iter().map(|&length| piece(length).len() as i32).collect();
        let before = |rank: usize| counts[..rank].iter().sum::<i32>();
        let starts: Vec<i32> = (0..counts.len()).map(before).collect();
        let mut received = vec![T::default(); before(counts.len()) as usize];
        let mut parts = PartitionMut::new(&mut received[..], &counts[..], &starts[..]);
        world.all_gather_varcount_into(&own[piece(own.len())], &mut parts);
        for ((all, &start), &count) in all.iter_mut().zip(&starts).zip(&counts) {
            all.extend_from_slice(&received[start as usize..][..count as usize]);
        }
    }
    all
}

/// The words of the only rank.
#[cfg(not(feature = "mpi"))]
fn all_gather<T: Word>(own: &[T], _: &[usize]) -> Vec<Vec<T>> {
    vec![own.to_vec()]
}
