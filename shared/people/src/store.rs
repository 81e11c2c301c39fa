//! Where this user keeps people: a folder each, which nobody else may enter.
//!
//! ```text
//! $XDG_DATA_HOME/tendon/people       else ~/.local/share/tendon/people
//!   anna/person.toml
//!   anna/person.previous.toml        the one before, if it was replaced
//!   anna/…                           the recordings of the calibration
//!   anna.lock                        held by who calibrates anna, free again however that ends
//! ```

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use tendon_paths::{PathError, PrivateFolder, data_folder};

use crate::file::PersonFileError;
use crate::name::PersonName;
use crate::person::Person;

/// A person's file in their folder.
const FILE: &str = "person.toml";
/// What was their file before, in the same folder.
const PREVIOUS: &str = "person.previous.toml";

/// All people of this user.
#[derive(Debug)]
pub struct People {
    folder: PrivateFolder,
}

/// Why a person cannot be kept or found.
#[derive(Debug, thiserror::Error)]
pub enum PeopleError {
    /// A folder cannot be used.
    #[error(transparent)]
    Path(#[from] PathError),
    /// Nobody of this name.
    #[error(
        "there is no person `{name}`{}: calibrate with `tendon calibrate {name}`, or name a person file",
        known(.people)
    )]
    Unknown {
        /// The name asked for.
        name: PersonName,
        /// The people there are.
        people: Vec<PersonName>,
    },
    /// Somebody has this name.
    #[error(
        "there is a person `{name}` already, in {}: take another name, or add --replace to put the new calibration in \
         its place",
        folder.display()
    )]
    Exists {
        /// The name.
        name: PersonName,
        /// Their folder.
        folder: PathBuf,
    },
    /// The file is of somebody else.
    #[error("{}: it is the file of `{found}`, not of `{name}`: put back the own one, or calibrate again", file.display())]
    OtherName {
        /// The file.
        file: PathBuf,
        /// The name asked for.
        name: PersonName,
        /// The name in it.
        found: PersonName,
    },
    /// Somebody else could have written the file.
    #[error(
        "{}: it belongs to somebody else, or others can write to it (mode {mode:04o}): if you trust it, run `chmod 600` \
         as its owner; else calibrate again",
        file.display()
    )]
    Untrusted {
        /// The file.
        file: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// Somebody else calibrates the person.
    #[error("`{name}` is being calibrated by another process: wait until it has ended, or take another name")]
    Busy {
        /// The name.
        name: PersonName,
    },
    /// A file beside the person's cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The person's file cannot be used.
    #[error(transparent)]
    File(#[from] PersonFileError),
    /// The people cannot be listed.
    #[error("cannot list {}", path.display())]
    List {
        /// The folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

fn known(people: &[PersonName]) -> String {
    if people.is_empty() {
        return " (there is nobody yet)".to_owned();
    }
    let names: Vec<&str> = people.iter().map(PersonName::as_str).collect();
    format!(", only {}", names.join(", "))
}

impl People {
    /// Opens this user's people; the folder is made if it is not there.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Path`] if there is no home, or the folder cannot be trusted.
    pub fn open() -> Result<People, PeopleError> {
        People::at(&data_folder()?.path().join("people"))
    }

    /// Opens the people in a folder; it is made if it is not there.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Path`] if the folder cannot be trusted.
    pub fn at(folder: &Path) -> Result<People, PeopleError> {
        Ok(People { folder: PrivateFolder::open(folder)? })
    }

    /// Where a person is kept.
    pub fn folder_of(&self, name: &PersonName) -> PathBuf {
        self.folder.path().join(name.as_str())
    }

    /// A person's file.
    pub fn file_of(&self, name: &PersonName) -> PathBuf {
        self.folder_of(name).join(FILE)
    }

    /// The names of all who have a person file, in order. What else lies in the folder is passed over.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Path`] if the folder cannot be read.
    pub fn names(&self) -> Result<Vec<PersonName>, PeopleError> {
        let mut names: Vec<PersonName> =
            self.folder.names()?.into_iter().filter_map(|name| PersonName::try_from(name).ok()).collect();
        names.retain(|name| self.file_of(name).exists());
        names.sort();
        Ok(names)
    }

    /// Reads a person.
    ///
    /// # Errors
    ///
    /// Nobody of that name, or what is wrong with the file.
    pub fn find(&self, name: &PersonName) -> Result<Person, PeopleError> {
        let file = self.file_of(name);
        if !file.exists() {
            return Err(PeopleError::Unknown { name: name.clone(), people: self.names()? });
        }
        self.check_owner(&file)?;
        let person = Person::read(&file)?;
        if person.name != *name {
            return Err(PeopleError::OtherName { file, name: name.clone(), found: person.name });
        }
        Ok(person)
    }

    /// Refuses a file that somebody else may have written: the folder of people is the user's own.
    fn check_owner(&self, file: &Path) -> Result<(), PeopleError> {
        let metadata = |path: &Path| {
            path.metadata().map_err(|source| PeopleError::List { path: path.to_owned(), source })
        };
        let (own, found) = (metadata(self.folder.path())?, metadata(file)?);
        let mode = found.mode() & 0o7777;
        if found.uid() != own.uid() || mode & 0o022 != 0 {
            return Err(PeopleError::Untrusted { file: file.to_owned(), mode });
        }
        Ok(())
    }

    /// Refuses a name that somebody has.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Exists`].
    pub fn check_new(&self, name: &PersonName) -> Result<(), PeopleError> {
        if self.file_of(name).exists() {
            return Err(PeopleError::Exists { name: name.clone(), folder: self.folder_of(name) });
        }
        Ok(())
    }

    /// Where a person's file goes when another one takes its place.
    pub fn previous_of(&self, name: &PersonName) -> PathBuf {
        self.folder_of(name).join(PREVIOUS)
    }

    /// Reserves a name for a calibration. Nobody else gets it until the result is dropped, or this process ends in any way.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Busy`] if somebody else has it.
    pub fn reserve(&self, name: &PersonName) -> Result<Reserved, PeopleError> {
        let path = self.folder.path().join(format!("{name}.lock"));
        let failed = |source: io::Error| PeopleError::Write { path: path.clone(), source };
        let file = OpenOptions::new().write(true).create(true).truncate(false).mode(0o600).open(&path);
        let file = file.map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Reserved { _lock: file }),
            Err(TryLockError::WouldBlock) => Err(PeopleError::Busy { name: name.clone() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Removes what stood for the reservation of a name; call it while that is still held, and nothing else is kept of the
    /// person.
    ///
    /// # Errors
    ///
    /// [`PeopleError::Path`] if it stays.
    pub fn forget(&self, name: &PersonName) -> Result<(), PeopleError> {
        Ok(self.folder.remove(&format!("{name}.lock"))?)
    }

    /// Keeps somebody new.
    ///
    /// # Errors
    ///
    /// There is somebody of that name, or the file cannot be written.
    pub fn add(&self, person: &Person) -> Result<PathBuf, PeopleError> {
        self.check_new(&person.name)?;
        self.replace(person)
    }

    /// Keeps a person in place of the one that has their name, if there is one, whose file stays as
    /// [`previous_of`](Self::previous_of). Returns the file. After a crash each file holds the old person or the new one.
    ///
    /// # Errors
    ///
    /// A file cannot be written.
    pub fn replace(&self, person: &Person) -> Result<PathBuf, PeopleError> {
        let folder = PrivateFolder::open(&self.folder_of(&person.name))?;
        self.keep_previous(&person.name)?;
        folder.write(FILE, person.to_text().as_bytes())?;
        Ok(folder.path().join(FILE))
    }

    /// Copies the file of a person, if there is one, to where the previous one is kept.
    fn keep_previous(&self, name: &PersonName) -> Result<(), PeopleError> {
        let (file, previous) = (self.file_of(name), self.previous_of(name));
        if !file.exists() {
            return Ok(());
        }
        let temporary = previous.with_extension(format!("new-{}", std::process::id()));
        let copied = fs::copy(&file, &temporary)
            .and_then(|_| File::open(&temporary)?.sync_all())
            .and_then(|()| fs::rename(&temporary, &previous));
        if copied.is_err() {
            let _ = fs::remove_file(&temporary);
        }
        copied.map_err(|source| PeopleError::Write { path: previous, source })
    }
}

/// A name that nobody else may calibrate for now.
#[derive(Debug)]
pub struct Reserved {
    /// Closed, and with it unlocked, when this is dropped.
    _lock: File,
}
