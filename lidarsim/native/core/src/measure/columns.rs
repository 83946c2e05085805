//! The columns of a scan: one table, from which its arrays follow.

use std::mem::MaybeUninit;

use crate::memory;

/// Calls a macro with the table of columns.
///
/// A column has a name, the type of an entry, the value of an unused entry, a condition on the [`Layout`],
/// and how a point cloud gets it: `copied` as it is, or `own` if the cloud computes it or does not have it.
/// Columns have an entry for each return that a pulse may have, or for each pulse. Entries `of_echoes` are
/// [`Entries`], those `of_rays` are computed for all rows at once.
#[macro_export]
macro_rules! scan_columns {
    ($then:ident) => {
        $then! {
            of_echoes {
                /// Measured distance from the beam's origin along the pulse, m.
                range: f64 = f64::NAN, always, copied;
                /// Distance along the direction that the pulse took, m.
                true_range: f64 = f64::NAN, always, copied;
                /// Measured minus true range, m.
                range_error: f64 = f64::NAN, always, copied;
                intensity: f32 = f32::NAN, always, copied;
                /// Unit, in the world.
                normal: [f32; 3] = [f32::NAN; 3], always, own;
                object_id: i32 = -1, always, copied;
                instance: u32 = 0, always, copied;
                label: u32 = 0, always, copied;
                /// What the light came from.
                source: u8 = u8::MAX, tells_sources, copied;
                /// How many surfaces the light passed, or was mirrored by, before this one.
                path: u8 = u8::MAX, goes_on, copied;
                /// Angle between ray and normal, rad.
                incidence: f32 = f32::NAN, always, copied;
            }
            of_rays {
                /// Direction of the light, in the sensor frame.
                true_direction: [f64; 3] = [f64::NAN; 3], strays, own;
                /// Where mirrored light comes from, in the sensor frame, m.
                mirrored_point: [f64; 3] = [f64::NAN; 3], mirrors, own;
                /// Rate of change of the true range, m/s.
                radial_velocity: f32 = f32::NAN, moves, copied;
            }
            of_pulses {
                status: u8 = u8::MAX, always, own;
                return_count: u8 = 0, always, own;
            }
        }
    };
}

/// How many entries a scan has, and which columns.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    pub pulses: usize,
    /// The most returns of a pulse, and so its rows.
    pub most: usize,
    /// Whether light may come from another direction than that of the pulse.
    pub strays: bool,
    /// Whether sensor or scene moves.
    pub moves: bool,
    /// Whether returns may come from anything but surfaces.
    pub tells_sources: bool,
    /// Whether light may go on from surfaces, and whether any mirror is among these.
    pub goes_on: bool,
    pub mirrors: bool,
}

impl Layout {
    fn rows(&self) -> usize {
        self.pulses.saturating_mul(self.most)
    }
}

/// The conditions of columns: the number of entries that a column has of so many.
impl Layout {
    pub fn always(&self, entries: usize) -> usize {
        entries
    }

    pub fn strays(&self, entries: usize) -> usize {
        if self.strays { entries } else { 0 }
    }

    pub fn moves(&self, entries: usize) -> usize {
        if self.moves { entries } else { 0 }
    }

    pub fn tells_sources(&self, entries: usize) -> usize {
        if self.tells_sources { entries } else { 0 }
    }

    pub fn goes_on(&self, entries: usize) -> usize {
        if self.goes_on { entries } else { 0 }
    }

    pub fn mirrors(&self, entries: usize) -> usize {
        if self.mirrors { entries } else { 0 }
    }
}

macro_rules! declare {
    (
        of_echoes {
            $($(#[$echo_doc:meta])* $echo:ident: $Echo:ty = $no_echo:expr, $has_echo:ident, $_e:ident;)+
        }
        of_rays { $($(#[$ray_doc:meta])* $ray:ident: $Ray:ty = $no_ray:expr, $has_ray:ident, $_r:ident;)+ }
        of_pulses {
            $($(#[$pulse_doc:meta])* $pulse:ident: $Pulse:ty = $no_pulse:expr, $has_pulse:ident, $_p:ident;)+
        }
    ) => {
        /// The columns of a scan. A column that the layout does not have is empty.
        pub struct ScanColumns {
            pub layout: Layout,
            $($(#[$echo_doc])* pub $echo: Vec<$Echo>,)+
            $($(#[$ray_doc])* pub $ray: Vec<$Ray>,)+
            $($(#[$pulse_doc])* pub $pulse: Vec<$Pulse>,)+
        }

        /// Uninitialized parts of the columns, for some pulses. A measurement writes each entry, or finds a
        /// bad pulse. A column that nobody wants is empty, and is not computed.
        pub struct Rows<'a> {
            layout: Layout,
            $($(#[$echo_doc])* pub $echo: &'a mut [MaybeUninit<$Echo>],)+
            $($(#[$ray_doc])* pub $ray: &'a mut [MaybeUninit<$Ray>],)+
            $($(#[$pulse_doc])* pub $pulse: &'a mut [MaybeUninit<$Pulse>],)+
        }

        /// N rows of what echoes and hits determine.
        pub(super) struct Entries<const N: usize> {
            $($(#[$echo_doc])* pub(super) $echo: [$Echo; N],)+
        }

        /// The values of unused entries.
        pub(super) mod unused {
            $(#[allow(dead_code, non_upper_case_globals)] pub const $ray: $Ray = $no_ray;)+
        }

        impl Layout {
            /// Bytes of all columns.
            fn bytes(&self) -> usize {
                let (rows, pulses) = (self.rows(), self.pulses);
                0_usize
                    $(.saturating_add(self.$has_echo(rows).saturating_mul(size_of::<$Echo>())))+
                    $(.saturating_add(self.$has_ray(rows).saturating_mul(size_of::<$Ray>())))+
                    $(.saturating_add(self.$has_pulse(pulses).saturating_mul(size_of::<$Pulse>())))+
            }
        }

        impl ScanColumns {
            /// With capacity for all entries. Unwinds if the system has no memory for them.
            pub fn new(layout: Layout) -> Self {
                ScanColumns::expect_room(layout);
                let (rows, pulses) = (layout.rows(), layout.pulses);
                ScanColumns {
                    layout,
                    $($echo: memory::with_capacity(layout.$has_echo(rows)),)+
                    $($ray: memory::with_capacity(layout.$has_ray(rows)),)+
                    $($pulse: memory::with_capacity(layout.$has_pulse(pulses)),)+
                }
            }

            /// All entries.
            pub fn rows(&mut self) -> Rows<'_> {
                let layout = self.layout;
                let (rows, pulses) = (layout.rows(), layout.pulses);
                Rows {
                    layout,
                    $($echo: &mut self.$echo.spare_capacity_mut()[..layout.$has_echo(rows)],)+
                    $($ray: &mut self.$ray.spare_capacity_mut()[..layout.$has_ray(rows)],)+
                    $($pulse: &mut self.$pulse.spare_capacity_mut()[..layout.$has_pulse(pulses)],)+
                }
            }

            /// # Safety
            ///
            /// All entries of `rows` must have been written.
            pub unsafe fn assume_written(&mut self) {
                let layout = self.layout;
                let (rows, pulses) = (layout.rows(), layout.pulses);
                // SAFETY: `rows` has taken these lengths from the capacity, and the caller has written all
                // entries.
                unsafe {
                    $(self.$echo.set_len(layout.$has_echo(rows));)+
                    $(self.$ray.set_len(layout.$has_ray(rows));)+
                    $(self.$pulse.set_len(layout.$has_pulse(pulses));)+
                }
            }
        }

        impl<'a> Rows<'a> {
            /// Without any column.
            pub fn none(layout: Layout) -> Rows<'a> {
                Rows {
                    layout,
                    $($echo: &mut [],)+
                    $($ray: &mut [],)+
                    $($pulse: &mut [],)+
                }
            }

            /// Splits off the entries of the first pulses.
            pub(super) fn split_off(&mut self, pulses: usize) -> Rows<'a> {
                let layout = Layout { pulses, ..self.layout };
                self.layout.pulses -= pulses;
                let rows = layout.rows();
                Rows {
                    layout,
                    $($echo: first(&mut self.$echo, layout.$has_echo(rows)),)+
                    $($ray: first(&mut self.$ray, layout.$has_ray(rows)),)+
                    $($pulse: first(&mut self.$pulse, layout.$has_pulse(pulses)),)+
                }
            }

            /// Writes N rows, those from N·part on, or as many as there are.
            #[inline(always)]
            pub(super) fn write<const N: usize>(&mut self, part: usize, entries: Entries<N>) {
                $(write(self.$echo, part, entries.$echo);)+
            }
        }

        impl<const N: usize> Entries<N> {
            pub(super) const UNUSED: Self = Entries { $($echo: [$no_echo; N]),+ };
        }
    };
}

scan_columns!(declare);

impl Rows<'_> {
    /// The measured ranges.
    ///
    /// # Safety
    ///
    /// They must have been written.
    pub(super) unsafe fn written_range(&self) -> &[f64] {
        // SAFETY: the caller has written all entries, and the types differ only in what they promise.
        unsafe { &*(std::ptr::from_ref::<[MaybeUninit<f64>]>(self.range) as *const [f64]) }
    }
}

impl ScanColumns {
    /// Unwinds if the system has no memory for the columns.
    pub fn expect_room(layout: Layout) {
        memory::expect_room(layout.bytes(), || {
            format!("the returns of {} pulses, {} each", layout.pulses, layout.most)
        });
    }
}

/// Splits off the first entries of a column; none if it is empty.
fn first<'a, T>(column: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let count = count.min(column.len());
    memory::split_off(column, count)
}

/// Writes N entries, those from N·part on, or as many as there are.
#[inline(always)]
pub(super) fn write<T: Copy, const N: usize>(entries: &mut [MaybeUninit<T>], part: usize, values: [T; N]) {
    match entries.as_chunks_mut().0.get_mut(part) {
        Some(entries) => *entries = values.map(MaybeUninit::new),
        None => {
            for (entry, value) in entries.iter_mut().skip(N * part).zip(values) {
                entry.write(value);
            }
        }
    }
}
