//! Checkpoints: rays are read from the file and the result is the same to the bit. Damaged files and files of other
//! computations are refused and stay as they are.

use std::{fs, path::Path, sync::Arc};

use crate::common::*;
use glam::DVec3;
use radiosity::{
    Error, Progress, Scene,
    form_factor::{CastOptions, Checkpoint, Estimator, FormFactors},
    patch::{Patches, Subdivision},
    trace::Tracer,
};

/// A lamp and a plate in a room. Their backs become patches while rays are cast.
fn furnished() -> Scene {
    let cell = part(room(DVec3::splat(-0.5), DVec3::splat(0.5)), 0.6, 0.0);
    let plate = part(level_square(0.6, 0.1, true), 0.3, 0.0);
    let lamp = part(level_square(0.2, 0.4, false), 0.0, 1.0);
    scene(&[cell, plate, lamp])
}

fn options(rays: f64) -> CastOptions {
    CastOptions::default().with_rays(rays).with_seed(5)
}

/// The results of all rays, bit by bit.
fn bits(f: &FormFactors) -> (Vec<u32>, Vec<(usize, u64)>, Vec<u64>) {
    let hits = f.ray_set().unwrap();
    let rows = (0..f.len()).flat_map(|i| f.row(i)).map(|(j, x)| (j, x.to_bits()));
    let escaped = f.escaped().iter().map(|x| x.to_bits());
    ((0..f.len()).flat_map(|i| hits.of(i)).copied().collect(), rows.collect(), escaped.collect())
}

/// Casts with this number of threads, with or without a checkpoint.
fn cast_with(
    scene: &Scene,
    patches: usize,
    options: &CastOptions,
    file: Option<&Arc<Checkpoint>>,
    threads: usize,
) -> FormFactors {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let (tracer, progress) = (Tracer::new(scene), Progress::new());
        let mut patches = Patches::subdivide(scene, &Subdivision::Count(patches));
        let file = file.cloned();
        FormFactors::cast_checkpointed(scene, &tracer, &mut patches, options, file, &progress).unwrap()
    })
}

fn open(path: &Path, scene: &Scene) -> Arc<Checkpoint> {
    Arc::new(Checkpoint::open(path, scene, 5).unwrap())
}

/// Bytes of the header.
const HEADER: usize = 56;

/// Bytes of an incomplete last record.
fn torn(file: &Checkpoint) -> u64 {
    file.torn().iter().map(|(_, bytes)| bytes).sum()
}

/// A finished checkpoint of 64 patches in a directory of its own.
fn finished(scene: &Scene) -> (tempfile::TempDir, std::path::PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rays.checkpoint");
    cast_with(scene, 64, &options(32.0), Some(&open(&path, scene)), 2);
    (dir, path)
}

/// The start of every record, and the end of the last.
fn records(bytes: &[u8]) -> Vec<usize> {
    let mut at = vec![HEADER];
    while at[at.len() - 1] < bytes.len() {
        let start = at[at.len() - 1];
        let length = u64::from_le_bytes(bytes[start..start + 8].try_into().unwrap());
        at.push(start + 16 + length as usize);
    }
    assert_eq!(at.last(), Some(&bytes.len()));
    at
}

/// The result has the same bits without a file, from an empty file, from a file cut anywhere between records, and
/// from a whole file, whatever the number of threads before and after.
#[test]
fn the_result_is_the_same_wherever_rays_come_from() {
    let scene = furnished();
    let dir = tempfile::tempdir().unwrap();
    for (k, estimator) in BOTH.into_iter().enumerate() {
        let options = options(64.0).with_estimator(estimator);
        let path = dir.path().join(format!("{k}.checkpoint"));
        let truth = bits(&cast_with(&scene, 300, &options, None, 1));
        let fresh = open(&path, &scene);
        assert!(bits(&cast_with(&scene, 300, &options, Some(&fresh), 7)) == truth);
        let all = fresh.rays();
        drop(fresh);
        let bytes = fs::read(&path).unwrap();
        let starts = records(&bytes);
        assert!(starts.len() > 8, "{} records", starts.len());
        for (cut, threads) in [(0, 2), (1, 64), (starts.len() / 2, 1), (starts.len() - 2, 7)] {
            fs::write(&path, &bytes[..starts[cut]]).unwrap();
            let resumed = open(&path, &scene);
            assert_eq!((resumed.found() == 0, torn(&resumed)), (cut == 0, 0));
            assert!(bits(&cast_with(&scene, 300, &options, Some(&resumed), threads)) == truth, "{cut}");
            assert_eq!(resumed.rays(), all);
        }
        let whole = open(&path, &scene);
        assert_eq!(whole.found(), all);
        assert!(bits(&cast_with(&scene, 300, &options, Some(&whole), 2)) == truth);
        assert_eq!(whole.rays(), all);
    }
}

/// Runs with fewer rays, more rays or other patches continue the same file: no ray is cast twice and no file is
/// refused. The number of backs depends on the rays that found them.
#[test]
fn other_runs_go_on_from_the_same_file() {
    let scene = furnished();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rays.checkpoint");
    let mut kept = 0;
    for (patches, rays, more) in
        [(200, 64.0, true), (200, 16.0, false), (200, 256.0, true), (100, 64.0, true), (200, 256.0, false)]
    {
        let file = open(&path, &scene);
        let with = cast_with(&scene, patches, &options(rays), Some(&file), 2);
        assert!(bits(&with) == bits(&cast_with(&scene, patches, &options(rays), None, 2)), "{rays}");
        let added = file.rays() - kept;
        let all = with.rays();
        assert_eq!(added > 0, more, "{patches} patches, {rays} rays: {added} of {all}");
        assert!(kept == 0 || patches != 200 || added < all, "no ray of the file was used");
        kept = file.rays();
    }
}

/// Casting more rays after a solution also reads rays from the file and adds new ones to it.
#[test]
fn later_rounds_are_kept() {
    let scene = furnished();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rays.checkpoint");
    let run = |file: Option<Arc<Checkpoint>>| {
        let (tracer, progress) = (Tracer::new(&scene), Progress::new());
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(100));
        let first =
            FormFactors::cast_checkpointed(&scene, &tracer, &mut patches, &options(64.0), file, &progress);
        first.unwrap().cast_more(&scene, &tracer, &mut patches, 200.0, &progress).unwrap()
    };
    let truth = bits(&run(None));
    let file = open(&path, &scene);
    let found = run(Some(file.clone()));
    assert!(bits(&found) == truth);
    assert_eq!(file.rays(), found.rays());
    drop((file, found));
    let file = open(&path, &scene);
    let kept = file.found();
    assert!(bits(&run(Some(file.clone()))) == truth);
    assert_eq!(file.rays(), kept);
}

/// A killed run can leave a record that is cut at any byte: opening removes it. A cut header is written again.
#[test]
fn a_torn_tail_is_cut_off_at_any_byte() {
    let scene = furnished();
    let (_dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    let starts = records(&bytes);
    let (last, end) = (starts[starts.len() - 2], bytes.len());
    fs::write(&path, &bytes[..last]).unwrap();
    let before = open(&path, &scene).found();
    for cut in last + 1..end {
        fs::write(&path, &bytes[..cut]).unwrap();
        let file = open(&path, &scene);
        assert_eq!((torn(&file), file.found()), ((cut - last) as u64, before), "{cut}");
        assert_eq!(fs::metadata(&path).unwrap().len(), last as u64);
    }
    for cut in 0..HEADER {
        fs::write(&path, &bytes[..cut]).unwrap();
        assert_eq!((open(&path, &scene).found(), fs::read(&path).unwrap()), (0, bytes[..HEADER].to_vec()));
    }
    let truth = bits(&cast_with(&scene, 64, &options(32.0), None, 2));
    for cut in [last + 1, last + 13, (last + end) / 2, end - 1] {
        fs::write(&path, &bytes[..cut]).unwrap();
        assert!(bits(&cast_with(&scene, 64, &options(32.0), Some(&open(&path, &scene)), 2)) == truth);
    }
}

/// A loss of power may leave a longer file that ends with zeros, from any byte on, to the end of a record or beyond
/// it.
#[test]
fn what_a_loss_of_power_leaves_is_cut_off() {
    let scene = furnished();
    let (_dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    let starts = records(&bytes);
    let last = &starts[starts.len() - 3..];
    let found = last[..2].iter().map(|&start| {
        fs::write(&path, &bytes[..start]).unwrap();
        open(&path, &scene).found()
    });
    for (found, ends) in found.collect::<Vec<_>>().into_iter().zip(last.windows(2)) {
        let (start, end) = (ends[0], ends[1]);
        let cuts = (start..start + 16).chain((start + 16..end - 6).step_by(61)).chain(end - 6..end);
        for (cut, size) in cuts.flat_map(|cut| [end, bytes.len(), bytes.len() + 5000].map(|size| (cut, size)))
        {
            let mut left = bytes[..cut].to_vec();
            left.resize(size, 0);
            if left[..end] == bytes[..end] {
                continue;
            }
            fs::write(&path, &left).unwrap();
            let file = open(&path, &scene);
            assert_eq!((torn(&file), file.found()), ((size - start) as u64, found), "{cut} of {size}");
            assert_eq!(fs::metadata(&path).unwrap().len(), start as u64);
        }
    }
    let truth = bits(&cast_with(&scene, 64, &options(32.0), None, 2));
    assert!(bits(&cast_with(&scene, 64, &options(32.0), Some(&open(&path, &scene)), 2)) == truth);
    assert!(fs::read(&path).unwrap().len() == bytes.len());
}

/// A file with one flipped bit is refused and stays as it is.
#[test]
fn damage_is_recognised_wherever_it_is() {
    let scene = furnished();
    let (_dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    let mut random = Random::new(3);
    let anywhere = (0..400).map(|_| (random.next() * bytes.len() as f64) as usize);
    let lengths = records(&bytes).into_iter().take(3).flat_map(|start| start..(start + 12).min(bytes.len()));
    for at in (0..HEADER).chain(lengths.collect::<Vec<_>>()).chain(anywhere) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        fs::write(&path, &damaged).unwrap();
        let error = Checkpoint::open(&path, &scene, 5).unwrap_err();
        assert!(matches!(error, Error::Input { .. }) && error.hint().is_some(), "{at}: {error}");
        assert!(fs::read(&path).unwrap() == damaged, "{at}");
    }
}

/// Impossible records with right checksums are refused when they are used.
#[test]
fn what_cannot_be_is_refused_even_with_right_checksums() {
    let scene = furnished();
    let (_dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    // The first target of the first record, hemisphere rays; and the first piece and weight of the last record,
    // shadow rays.
    let records = records(&bytes);
    let body = |k: usize| (records[k] + 12, records[k + 1] - 4);
    let (first, last) = (body(0), body(records.len() - 2));
    let ray = |(start, _): (usize, usize)| start + 8 + 20;
    // Two patches that do not exist, a piece of no lamp, and a weight that is no number.
    for ((start, end), at, value) in [
        (first, ray(first), &[0xff, 0xff, 0xff, 0x7f]),
        (first, ray(first), &[0xf0, 0xff, 0xff, 0xff]),
        (last, ray(last), &[0, 0, 0, 1]),
        (last, ray(last) + 4, &f32::NAN.to_le_bytes()),
    ] {
        let mut crafted = bytes.clone();
        crafted[at..at + value.len()].copy_from_slice(value);
        let check = crc32fast::hash(&crafted[start..end]);
        crafted[end..end + 4].copy_from_slice(&check.to_le_bytes());
        fs::write(&path, &crafted).unwrap();
        let (tracer, progress) = (Tracer::new(&scene), Progress::new());
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(64));
        let file = Some(open(&path, &scene));
        let cast =
            FormFactors::cast_checkpointed(&scene, &tracer, &mut patches, &options(32.0), file, &progress);
        let error = cast.map(|_| ()).unwrap_err();
        assert!(matches!(error, Error::Input { .. }), "{value:?} at {at}: {error}");
        assert!(error.to_string().contains("damaged"), "{error}");
    }
}

/// Files of other computations are refused with the reason and stay as they are.
#[test]
fn what_is_foreign_is_refused() {
    let scene = furnished();
    let (dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    let refused = |path: &Path, scene: &Scene, seed: u64, why: &str| {
        let before = fs::read(path).unwrap();
        let error = Checkpoint::open(path, scene, seed).unwrap_err();
        assert!(error.to_string().contains(why), "{error} instead of {why}");
        assert!(error.to_string().starts_with(&path.display().to_string()) && error.hint().is_some());
        assert!(fs::read(path).unwrap() == before);
    };
    refused(&path, &scene, 6, "of seed 5");
    let mut moved = scene.clone();
    moved.vertices[0].x -= 1e-9;
    refused(&path, &moved, 5, "of another scene");
    let mut painted = scene.clone();
    painted.materials[0].reflectance[1] += 1e-9;
    refused(&path, &painted, 5, "of another scene");
    let mut lit = scene.clone();
    lit.materials[2].emission[0] *= 2.0;
    refused(&path, &lit, 5, "of another scene");

    let other = dir.path().join("notes.txt");
    for text in
        ["x", "Notes on many things, longer than the header of a checkpoint is.", "radiosity rays\r\n?"]
    {
        fs::write(&other, text).unwrap();
        refused(&other, &scene, 5, "not a checkpoint");
    }
    // A header of another version with a right checksum.
    let mut newer = bytes.clone();
    newer[20] ^= 1;
    let check = crc32fast::hash(&newer[..HEADER - 4]);
    newer[HEADER - 4..HEADER].copy_from_slice(&check.to_le_bytes());
    fs::write(&path, &newer).unwrap();
    refused(&path, &scene, 5, "another version");
    let textured = load("textured");
    let of_texture = dir.path().join("textured.checkpoint");
    cast_with(&textured, 64, &options(16.0), Some(&open(&of_texture, &textured)), 2);
    let mut repainted = textured.clone();
    let texture = &mut repainted.textures[0];
    let (width, height) = texture.size();
    let mut texels = texture.texels().to_vec();
    texels[0] ^= 1;
    *texture = radiosity::scene::Texture::new(width, height, texels);
    refused(&of_texture, &repainted, 5, "of another scene");
}

/// The order of the records does not matter, and rays that are in the file twice count once. Rays whose predecessors are
/// missing are not used.
#[test]
fn records_may_come_in_any_order() {
    let scene = furnished();
    let (_dir, path) = finished(&scene);
    let bytes = fs::read(&path).unwrap();
    let truth = bits(&cast_with(&scene, 64, &options(32.0), None, 2));
    let all = open(&path, &scene).found();
    let second = records(&bytes)[1];
    let (header, first, rest) = (&bytes[..HEADER], &bytes[HEADER..second], &bytes[second..]);
    for (mixed, whole) in [
        ([header, rest, first].concat(), true),
        ([header, first, rest, rest].concat(), true),
        ([header, rest].concat(), false),
    ] {
        fs::write(&path, mixed).unwrap();
        let file = open(&path, &scene);
        assert_eq!(file.found() == all, whole);
        assert!(bits(&cast_with(&scene, 64, &options(32.0), Some(&file), 2)) == truth);
        assert_eq!(file.rays(), all);
    }
}

/// Two runs never write to one file. A run that kept no rays removes its file. A folder or a device is no checkpoint.
#[test]
fn a_checkpoint_is_one_runs_own() {
    let scene = furnished();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rays.checkpoint");
    let first = Checkpoint::open(&path, &scene, 5).unwrap();
    let second = Checkpoint::open(&path, &scene, 5).unwrap_err();
    assert!(second.to_string().ends_with("another run is using this checkpoint"), "{second}");
    drop(first);
    assert!(!path.exists());
    assert!(matches!(Checkpoint::open(dir.path(), &scene, 5), Err(Error::Input { .. })));
    assert!(matches!(Checkpoint::open(&dir.path().join("no/file"), &scene, 5), Err(Error::Io { .. })));
}

/// Both estimators cast the same hemisphere rays, but one-way form factors cast more of them. One file serves both.
#[test]
fn estimators_do_not_take_each_others_rays() {
    let scene = furnished();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rays.checkpoint");
    for estimator in [Estimator::Pooled, Estimator::OneWay, Estimator::Pooled] {
        let options = options(32.0).with_estimator(estimator);
        let with = cast_with(&scene, 64, &options, Some(&open(&path, &scene)), 2);
        assert!(bits(&with) == bits(&cast_with(&scene, 64, &options, None, 2)));
    }
}
