//! From pulses to returns.
//!
//! A batch of pulses is aimed, with its jitter, and cast (`fire.rs`). What the receiver does not see is no
//! hit (`shadow.rs`). Light goes on through panes and from mirrors (`light_transport.rs`). Hits become light
//! (`light.rs`), light becomes echoes, one a ray (`single_ray.rs`) or those of a waveform over the footprint
//! of a beam (`footprint.rs`), and the effects of the receiver turn echoes into readings (`effects/`), the
//! range gate last. `recording.rs` samples the waveforms themselves, where they are asked for. The rows of a
//! scan are written to its columns (`columns.rs`), from which `returns.rs` and `points.rs` make a point
//! cloud. `coverage.rs` tells how much of each instance pulses reach, without those
//! that `culling.rs` finds to meet none.

mod appearance;
mod backscatter;
mod beam;
mod columns;
mod coverage;
mod culling;
mod direction;
mod echo;
mod effects;
mod fire;
mod footprint;
mod frame;
mod grain;
mod hit_places;
mod light;
mod light_paths;
mod light_transport;
mod many;
mod measurement;
mod parameters;
mod points;
mod range_rate;
mod recording;
mod returns;
pub mod rng;
mod scan;
mod scratch;
mod shadow;
mod single_ray;
mod slopes;
mod source;
mod status;
mod texture;
mod waveform;
mod weather;

pub use appearance::{Appearance, Labels, Reflectivity};
pub use backscatter::Backscatter;
pub use columns::{Layout, Rows, ScanColumns};
pub use coverage::{CoverPiece, InstancePulses, NominalPulses, Targets, UNKNOWN};
pub use frame::{BadPulse, Fault, Frame};
pub use grain::Grain;
pub use light_paths::LightTransport;
pub use many::measure_all;
pub use measurement::Measurement;
pub use parameters::{Parameters, Value};
pub use points::{Coordinates, MoverPoses, PointSource, PointsAndNormals, WritePoints};
pub use recording::{Recorder, Recording, Samples, Window};
pub use returns::{Copied, Each, Field, Numbers, ReturnCounts};
pub use scan::{Batch, Scan};
pub use texture::{Interpolation, Texture, TextureCoordinates, TextureMap, Wrap};
