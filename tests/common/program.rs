//! Runs the program in a directory of its own.

// Each test program uses a part of this.
#![allow(dead_code)]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use tempfile::TempDir;

/// A directory with a scene in it.
pub struct Here(TempDir);

impl Here {
    pub fn new(obj: &str, mtl: &str) -> Here {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("scene.obj"), obj).unwrap();
        fs::write(dir.path().join("scene.mtl"), mtl).unwrap();
        Here(dir)
    }

    /// The directory.
    pub fn directory(&self) -> &Path {
        self.0.path()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.read(name)).unwrap()
    }

    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Runs `radiosity` with the words of `arguments` in this directory.
    pub fn run(&self, arguments: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_radiosity"))
            .current_dir(self.0.path())
            .args(arguments.split_whitespace())
            .output()
            .unwrap()
    }

    /// Runs a command that must fail with `status` and leave no file. Returns stderr.
    pub fn fails(&self, arguments: &str, status: i32) -> String {
        let before = self.names();
        let output = self.run(arguments);
        let errors = stderr(&output);
        assert_eq!(output.status.code(), Some(status), "{arguments}: {errors}");
        assert_eq!(self.names(), before, "{arguments}");
        assert!(output.stdout.is_empty());
        assert!(!errors.contains("panicked"), "{errors}");
        errors
    }
}

/// The stderr of a run.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}
