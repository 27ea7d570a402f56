//! Locomotion: root paths, footsteps and the roll of the foot.

use datasets_spec::{Joint, Rng, Skeleton};
use glam::{DQuat, DVec3};
use rand::RngExt;

use super::curve::{Track, ease};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Left,
    Right,
}

impl Side {
    /// Both sides, left first.
    pub(super) const BOTH: [Side; 2] = [Side::Left, Side::Right];

    /// The sign of x on this side: the left of the body is +x.
    pub(super) fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }

    pub(super) fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }

    pub(super) fn draw(rng: &mut Rng) -> Self {
        if rng.random_bool(0.5) {
            Self::Left
        } else {
            Self::Right
        }
    }

    /// "left" or "right".
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }

    /// Mirrors a vector given for the left side if this is the right one.
    pub(super) fn mirror(self, v: DVec3) -> DVec3 {
        DVec3::new(v.x * self.sign(), v.y, v.z)
    }
}

/// Samples per second of an integrated path: twice the corpus rate, so that a footstep falls
/// within a few millimetres of the path.
const PATH_HZ: f64 = 120.0;

/// The path of the body over the floor: the point below the pelvis and the heading, over time.
#[derive(Clone, Debug)]
pub(super) struct RootPath {
    from_secs: f64,
    points: Vec<(DVec3, f64)>,
}

impl RootPath {
    /// A body that stays at the origin and faces +z.
    pub(super) fn still() -> Self {
        Self {
            from_secs: 0.0,
            points: vec![(DVec3::ZERO, 0.0)],
        }
    }

    /// Integrates a velocity in m/s, given in the frame of the heading (left, up, forward), and a
    /// heading in radians. The path is at the origin at time 0.
    pub(super) fn integrate(
        from_secs: f64,
        to_secs: f64,
        velocity: impl Fn(f64) -> DVec3,
        heading: impl Fn(f64) -> f64,
    ) -> Self {
        let steps = ((to_secs - from_secs) * PATH_HZ).ceil() as usize;
        let mut points = Vec::with_capacity(steps + 1);
        let mut position = DVec3::ZERO;
        for step in 0..=steps {
            let secs = from_secs + step as f64 / PATH_HZ;
            points.push((position, heading(secs)));
            // The midpoint rule.
            let middle = secs + 0.5 / PATH_HZ;
            position += DQuat::from_rotation_y(heading(middle)) * velocity(middle) / PATH_HZ;
        }
        let mut path = Self { from_secs, points };
        let (origin, _) = path.at(0.0);
        for (position, _) in &mut path.points {
            *position -= origin;
        }
        path
    }

    /// Samples a function of time that gives the point on the floor and the heading, from 0 to `to_secs`.
    pub(super) fn sample(to_secs: f64, place: impl Fn(f64) -> (DVec3, f64)) -> Self {
        let steps = (to_secs * PATH_HZ).ceil() as usize;
        Self {
            from_secs: 0.0,
            points: (0..=steps)
                .map(|step| place(step as f64 / PATH_HZ))
                .collect(),
        }
    }

    /// The point on the floor and the heading at a time.
    pub(super) fn at(&self, secs: f64) -> (DVec3, f64) {
        let last = self.points.len() - 1;
        let at = ((secs - self.from_secs) * PATH_HZ).clamp(0.0, last as f64);
        let before = (at.floor() as usize).min(last.saturating_sub(1));
        let after = (before + 1).min(last);
        let alpha = at - before as f64;
        let ((from, from_heading), (to, to_heading)) = (self.points[before], self.points[after]);
        (
            from.lerp(to, alpha),
            from_heading + alpha * (to_heading - from_heading),
        )
    }
}

/// The points of one foot that matter for its roll, relative to the ankle of a foot flat on the
/// floor.
#[derive(Clone, Copy, Debug)]
pub(super) struct FootShape {
    toe: DVec3,
    heel: DVec3,
}

/// Distance of the heel's contact point behind the ankle in metres. The skeleton has no heel joint; 5 cm fits an adult
/// foot.
const HEEL_BEHIND_ANKLE: f64 = 0.05;

impl FootShape {
    pub(super) fn new(skeleton: &Skeleton, foot: Joint) -> Self {
        let toe = skeleton.offset(foot.index());
        Self {
            toe,
            heel: DVec3::new(0.0, toe.y, -HEEL_BEHIND_ANKLE),
        }
    }

    /// Height of the ankle of a flat foot whose toe joint is on the floor, in metres.
    pub(super) fn ankle_height(&self) -> f64 {
        -self.toe.y
    }

    /// Position of the ankle and rotation of a foot that stood flat at `flat_ankle` and is pitched about its contact
    /// point: the toe joint if the toes point down (positive pitch), the heel if they point up.
    pub(super) fn roll(&self, flat_ankle: DVec3, yaw: f64, pitch: f64) -> (DVec3, DQuat) {
        let flat = DQuat::from_rotation_y(yaw);
        let rotation = flat * DQuat::from_rotation_x(pitch);
        let pivot = if pitch >= 0.0 { self.toe } else { self.heel };
        (flat_ankle + flat * pivot - rotation * pivot, rotation)
    }
}

/// A foot planted at one place.
#[derive(Clone, Copy, Debug)]
struct Plant {
    from: f64,
    to: f64,
    /// The floor below the ankle.
    place: DVec3,
    yaw: f64,
}

/// Path of a foot from one plant to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Swing {
    /// Greatest height of the contact point above the floor in metres.
    pub(super) lift: f64,
    /// Whether the body is in free flight, so that the height follows a parabola.
    pub(super) ballistic: bool,
    /// Pitch of the foot in radians when the toe leaves the floor, toes down being positive.
    pub(super) off: f64,
    /// Pitch early in the swing.
    pub(super) peak: f64,
    /// Pitch at touch-down; negative for a heel strike.
    pub(super) strike: f64,
}

impl Swing {
    /// A step that rolls over the foot; the pitches are those at lift-off, early in the swing and at touch-down.
    pub(super) const fn rolling(lift: f64, [off, peak, strike]: [f64; 3]) -> Self {
        Self {
            lift,
            ballistic: false,
            off,
            peak,
            strike,
        }
    }

    /// Height above the floor at the fraction `u` of the swing.
    fn height(&self, u: f64) -> f64 {
        if self.ballistic {
            4.0 * self.lift * u * (1.0 - u)
        } else {
            // Vertical speed and acceleration vanish at both ends; the maximum is at u = 1/2.
            64.0 * self.lift * (u * (1.0 - u)).powi(3)
        }
    }
}

/// The plants and swings of one foot over a clip.
#[derive(Clone, Debug)]
pub(super) struct FootTrack {
    plants: Vec<Plant>,
    swings: Vec<Swing>,
    pitch: Track<1>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct FootSample {
    /// Point below the ankle of the flat foot; y is the height of the foot above the floor in metres.
    pub(super) place: DVec3,
    pub(super) yaw: f64,
    pub(super) pitch: f64,
    pub(super) planted: bool,
}

/// The fraction of its way that a swinging foot has covered: it leaves and reaches the floor at rest, and is at most
/// 1.6 times as fast as on average, between the 1.5 of a cubic and the 1.9 of a minimum-jerk profile.
fn stride(u: f64) -> f64 {
    let cubic = u * u * (3.0 - 2.0 * u);
    cubic + 0.3 * (ease(u) - cubic)
}

/// Longest time the heel takes to rise before the toe leaves the floor, in seconds.
const HEEL_RISE_SECS: f64 = 0.32;
/// Longest time the foot takes to lie flat after touch-down, in seconds.
const SETTLE_SECS: f64 = 0.11;

impl FootTrack {
    /// A foot that steps at the given times `(lift-off, touch-down, place, yaw, swing)`, having
    /// stood at `place` with `yaw` before.
    pub(super) fn new(place: DVec3, yaw: f64, steps: &[(f64, f64, DVec3, f64, Swing)]) -> Self {
        let mut plants = vec![Plant {
            from: f64::NEG_INFINITY,
            to: f64::INFINITY,
            place,
            yaw,
        }];
        let mut swings = Vec::with_capacity(steps.len());
        for &(off, on, place, yaw, swing) in steps {
            if let Some(last) = plants.last_mut() {
                assert!(
                    off > last.from,
                    "a foot lifts off at {off} s before it has landed"
                );
                last.to = off;
            }
            plants.push(Plant {
                from: on,
                to: f64::INFINITY,
                place,
                yaw,
            });
            swings.push(swing);
        }
        let mut keys = Vec::with_capacity(6 * steps.len() + 1);
        for (pair, swing) in plants.windows(2).zip(&swings) {
            let (off, on) = (pair[0].to, pair[1].from);
            // The heel rises in the second half of the stance and the sole settles in its first
            // third, so that the foot is flat in between however short the stance is.
            let rise = HEEL_RISE_SECS.min(0.5 * (off - pair[0].from));
            let settle = SETTLE_SECS.min(0.3 * (pair[1].to - on));
            let flight = on - off;
            keys.extend([
                (off - rise, [0.0]),
                (off, [swing.off]),
                (off + 0.2 * flight, [swing.peak]),
                (off + 0.65 * flight, [0.1 * swing.peak + 0.5 * swing.strike]),
                (on, [swing.strike]),
                (on + settle, [0.0]),
            ]);
        }
        Self {
            plants,
            swings,
            pitch: Track::new(keys),
        }
    }

    pub(super) fn at(&self, secs: f64) -> FootSample {
        let [pitch] = self.pitch.at(secs);
        let index = self.plants.partition_point(|plant| plant.from <= secs) - 1;
        let plant = &self.plants[index];
        if secs <= plant.to {
            return FootSample {
                place: plant.place,
                yaw: plant.yaw,
                pitch,
                planted: true,
            };
        }
        let next = &self.plants[index + 1];
        let u = (secs - plant.to) / (next.from - plant.to);
        let alpha = if self.swings[index].ballistic {
            u
        } else {
            stride(u)
        };
        FootSample {
            place: plant.place.lerp(next.place, alpha) + DVec3::Y * self.swings[index].height(u),
            yaw: plant.yaw + alpha * (next.yaw - plant.yaw),
            pitch,
            planted: false,
        }
    }

    /// Mid-times in seconds of the stances that have a beginning and an end.
    pub(super) fn mid_stances(&self) -> impl Iterator<Item = f64> + '_ {
        self.plants
            .iter()
            .map(|plant| 0.5 * (plant.from + plant.to))
            .filter(|middle| middle.is_finite())
    }
}

/// Alternating steps along a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gait {
    /// Mean time from one touch-down to the other foot's in seconds.
    pub(super) step_secs: f64,
    /// Share of a cycle in which a foot is on the floor: above a half for walking, below for running.
    pub(super) duty: f64,
    /// Distance of each ankle from the line of travel in metres.
    pub(super) half_width: f64,
    /// How far the feet point outwards in radians.
    pub(super) toe_out: f64,
    /// Roll and lift of a step of [`Gait::FULL_STEP`] metres; shorter steps roll less.
    pub(super) swing: Swing,
    /// Relative scatter of the step times.
    pub(super) jitter: f64,
    pub(super) first: Side,
}

impl Gait {
    /// Step length in metres at which the foot rolls fully, as in a brisk walk.
    const FULL_STEP: f64 = 0.7;
    /// Distance of the ankles behind the point below the pelvis in metres, as in the rest pose of
    /// the skeleton.
    pub(super) const ANKLE_BEHIND: f64 = 0.05;

    /// Fraction of its stance after which a foot is below the body. It is less than a half, because the trailing leg,
    /// with its heel raised, reaches further than the leading one.
    const BELOW_BODY: f64 = 0.42;

    /// Position and direction of a foot under a body at a point of its path.
    pub(super) fn place(&self, side: Side, (point, heading): (DVec3, f64)) -> (DVec3, f64) {
        let offset = DVec3::new(side.sign() * self.half_width, 0.0, -Self::ANKLE_BEHIND);
        (
            point + DQuat::from_rotation_y(heading) * offset,
            heading + side.sign() * self.toe_out,
        )
    }

    /// Steps along a path from `from` to `to` seconds, standing before and after. Each foot is placed below the
    /// body near the middle of its stance, so that walks, turns, side steps and halts need one rule.
    pub(super) fn plan(
        &self,
        path: &RootPath,
        from: f64,
        to: f64,
        rng: &mut Rng,
    ) -> [FootTrack; 2] {
        let swing_secs = 2.0 * self.step_secs * (1.0 - self.duty);
        let mut offs = [Vec::new(), Vec::new()];
        let mut at = from;
        let mut side = self.first;
        while at + swing_secs <= to {
            offs[side as usize].push(at);
            at += self.step_secs * (1.0 + self.jitter * rng.random_range(-1.0..1.0));
            side = side.other();
        }
        Side::BOTH.map(|side| {
            let offs = &offs[side as usize];
            let (start, start_yaw) = self.place(side, path.at(from));
            let mut previous = start;
            let steps: Vec<_> = offs
                .iter()
                .enumerate()
                .map(|(step, &off)| {
                    let on = off + swing_secs;
                    let middle = match offs.get(step + 1) {
                        Some(next) => on + Self::BELOW_BODY * (next - on),
                        None => to.max(on),
                    };
                    let (place, yaw) = self.place(side, path.at(middle));
                    let length = 0.5 * (place - previous).length() / Self::FULL_STEP;
                    previous = place;
                    (off, on, place, yaw, self.scaled(length.min(1.3)))
                })
                .collect();
            FootTrack::new(start, start_yaw, &steps)
        })
    }

    /// The swing of a step `length` times as long as a full one: the foot of a short step rolls
    /// little but still clears the floor.
    fn scaled(&self, length: f64) -> Swing {
        Swing {
            lift: self.swing.lift * (0.55 + 0.45 * length),
            ballistic: self.swing.ballistic,
            off: self.swing.off * (0.3 + 0.7 * length),
            peak: self.swing.peak * (0.3 + 0.7 * length),
            strike: self.swing.strike * length,
        }
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;

    const WALK: Gait = Gait {
        step_secs: 0.55,
        duty: 0.62,
        half_width: 0.08,
        toe_out: 0.05,
        swing: Swing::rolling(0.04, [0.7, 0.9, -0.3]),
        jitter: 0.02,
        first: Side::Left,
    };

    #[test]
    fn a_quarter_circle_ends_beside_its_start() {
        // A quarter turn to the left at 1 m/s and pi/2 rad/s ends at (2/pi, 2/pi) metres.
        let quarter = std::f64::consts::FRAC_PI_2;
        let path = RootPath::integrate(0.0, 1.0, |_| DVec3::Z, |secs| quarter * secs);
        let (point, heading) = path.at(1.0);
        let expected = DVec3::new(1.0, 0.0, 1.0) / quarter;
        // The midpoint rule has an error of (rotation per sample)^2 / 24 of the path, here below 1e-5.
        assert!((point - expected).length() < 1e-5, "{point}");
        assert!((heading - quarter).abs() < 1e-12);
    }

    #[test]
    fn a_rolling_foot_keeps_its_contact_point() {
        let foot = FootShape::new(&Skeleton::smplx_neutral(), Joint::LeftFoot);
        let flat = DVec3::new(0.3, foot.ankle_height(), -0.2);
        for (pitch, pivot) in [(0.6, foot.toe), (-0.3, foot.heel), (0.0, foot.toe)] {
            let (ankle, rotation) = foot.roll(flat, 0.4, pitch);
            let expected = flat + DQuat::from_rotation_y(0.4) * pivot;
            assert!((ankle + rotation * pivot - expected).length() < 1e-12);
        }
    }

    #[test]
    fn a_walking_body_always_has_a_foot_on_the_floor() {
        let path = RootPath::integrate(-1.0, 8.0, |_| DVec3::Z * 1.2, |_| 0.0);
        let feet = WALK.plan(&path, -1.0, 6.0, &mut Seed(1).rng(&["walk"]));
        for frame in 0..420 {
            let samples = feet.each_ref().map(|foot| foot.at(frame as f64 / 60.0));
            assert!(samples.iter().any(|sample| sample.planted), "frame {frame}");
            assert!(samples.iter().all(|sample| sample.place.y >= 0.0));
        }
        let stand = feet.each_ref().map(|foot| foot.at(7.0).place);
        // They end side by side.
        let off = stand[0] - stand[1] - DVec3::X * 0.16;
        assert!(off.length() < 1e-9, "{off}");
    }
}
