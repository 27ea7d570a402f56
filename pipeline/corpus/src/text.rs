//! Descriptions of a clip: sentences about the whole body and phrases about its parts.

use datasets_spec::table::{Caption, PartCaption};
use datasets_spec::{BodyPart, Rng};
use rand::RngExt;

use super::action::{Action, Facts};

/// Captions per clip: HumanML3D has three or four, KIT-ML one to three.
const CAPTIONS: std::ops::RangeInclusive<usize> = 2..=3;

/// Describes a clip: captions of the whole body, and phrases that complete "The person is ...".
pub(super) fn describe(
    action: Action,
    style: &str,
    facts: Facts,
    rng: &mut Rng,
) -> (Vec<Caption>, Vec<PartCaption>) {
    let captions = captions(action, manners(style), facts, rng);
    let parts = parts(action, facts)
        .into_iter()
        .map(|(part, phrase)| PartCaption {
            part: part.name().to_owned(),
            text: fill(phrase, "", part_manner(style), facts),
        })
        .collect();
    (captions, parts)
}

/// Captions of the whole body for an action in one of the manners, each empty or with a leading space; there must
/// be one.
pub(super) fn captions(
    action: Action,
    manners: &[&'static str],
    facts: Facts,
    rng: &mut Rng,
) -> Vec<Caption> {
    let mut sentences = sentences(action).to_vec();
    let mut manners = manners.to_vec();
    let num_captions = rng.random_range(CAPTIONS);
    (0..num_captions)
        .map(|_| {
            let sentence = sentences.swap_remove(rng.random_range(0..sentences.len()));
            let who = SUBJECTS[rng.random_range(0..SUBJECTS.len())];
            // Manners do not repeat within a clip, as far as there are enough.
            let how = if manners.len() > 1 {
                manners.swap_remove(rng.random_range(0..manners.len()))
            } else {
                manners[0]
            };
            Caption {
                text: fill(sentence, who, how, facts),
                ..Caption::default()
            }
        })
        .collect()
}

const SUBJECTS: [&str; 4] = ["a person", "someone", "the person", "a figure"];

/// Fills a template: `{who}`, `{how}` (empty or with a leading space), `{side}`, `{other}`,
/// `{times}`, and `{turn}` for a turn of as many half turns as the count says less one.
fn fill(template: &str, who: &str, how: &str, facts: Facts) -> String {
    let times = match facts.count {
        2 => "twice",
        3 => "three times",
        _ => "a few times",
    };
    let turn = match facts.count {
        2 => "half a turn",
        _ => "a full turn",
    };
    template
        .replace("{who}", who)
        .replace("{how}", how)
        .replace("{side}", facts.side.word())
        .replace("{other}", facts.side.other().word())
        .replace("{times}", times)
        .replace("{turn}", turn)
}

/// Words of a style for the whole body.
fn manners(style: &str) -> &'static [&'static str] {
    match style {
        "proud" => &[
            " proudly",
            " with the chest out",
            " with the head held high",
            " full of pride",
        ],
        "old" => &[
            " like an old person",
            " slowly and stiffly like an elderly person",
            " with a bent back, as if very old",
        ],
        "playful" => &[
            " playfully",
            " cheerfully",
            " in high spirits",
            " with a bouncy, playful manner",
        ],
        "depressed" => &[
            " sadly",
            " with a hanging head",
            " in a depressed mood",
            " without any energy, as if depressed",
        ],
        "angry" => &[
            " angrily",
            " in a rage",
            " with angry, forceful movements",
            " as if furious",
        ],
        _ => &[""],
    }
}

/// Words of a style for one part.
fn part_manner(style: &str) -> &'static str {
    manners(style)[0]
}

fn sentences(action: Action) -> &'static [&'static str] {
    match action {
        Action::Walk => &[
            "{who} walks forward{how}",
            "{who} is walking straight ahead{how}",
            "{who} takes several steps forward{how}",
            "{who} walks ahead at an even pace{how}",
        ],
        Action::WaveRight | Action::WaveLeft => &[
            "{who} raises the {side} hand and waves{how}",
            "{who} stands and waves with the {side} hand{how}",
            "{who} greets somebody by waving the {side} arm{how}",
            "with the {side} hand raised, {who} waves{how}",
        ],
        Action::Punch => &[
            "{who} boxes{how}, throwing left and right punches",
            "{who} takes a fighting stance and punches the air{how}",
            "{who} throws jabs with the left hand and crosses with the right hand{how}",
        ],
        Action::Sit => &[
            "{who} sits down{how}, stays seated for a moment and gets up again",
            "{who} sits down on a chair and stands back up{how}",
            "from standing, {who} takes a seat{how} and then rises",
        ],
        Action::Run => &[
            "{who} runs forward{how}",
            "{who} is running fast in a straight line{how}",
            "{who} sprints ahead{how}",
        ],
        Action::Kick => &[
            "{who} kicks forward with the {side} leg and then with the {other} leg{how}",
            "{who} does two front kicks{how}, first {side}, then {other}",
            "with raised fists, {who} kicks the air twice{how}",
        ],
        Action::RaiseArms => &[
            "{who} raises both arms above the head and lowers them again, twice{how}",
            "{who} lifts both arms out to the sides and overhead to stretch{how}",
            "{who} stretches with both arms up in the air{how}",
        ],
        Action::WalkWave => &[
            "{who} walks forward while waving with the {side} hand{how}",
            "{who} waves the {side} hand and keeps walking{how}",
            "walking ahead, {who} raises the {side} arm to wave{how}",
        ],
        Action::Squat => &[
            "{who} does squats{how}, going down {times}",
            "{who} squats {times} with both arms stretched forward{how}",
            "{who} bends the knees to crouch down and comes up again, {times}{how}",
        ],
        Action::Throw => &[
            "{who} throws something overarm with the {side} hand, twice{how}",
            "{who} steps forward and throws a ball with the {side} arm{how}",
            "{who} winds up and throws with the {side} hand{how}",
        ],
        Action::WalkBackward => &[
            "{who} walks backward{how}",
            "{who} steps back several times{how}",
            "{who} is moving backwards on foot{how}",
        ],
        Action::Clap => &[
            "{who} claps the hands several times{how}",
            "{who} stands and applauds{how}",
            "{who} is clapping in front of the chest{how}",
        ],
        Action::Jump => &[
            "{who} jumps up and down on the spot{how}",
            "{who} jumps straight up several times{how}",
            "{who} swings both arms and jumps in place{how}",
        ],
        Action::Turn => &[
            "{who} turns {turn} to the {side} on the spot{how}",
            "{who} steps around in place to the {side}{how}",
            "{who} makes {turn} to the {side} with small steps{how}",
        ],
        Action::Jog => &[
            "{who} jogs forward{how}",
            "{who} is jogging at a moderate speed{how}",
            "{who} goes for a light run{how}",
        ],
        Action::PickUp => &[
            "{who} bends down{how}, picks something up with the {side} hand and straightens",
            "{who} picks up an object from the floor with the {side} hand{how}",
            "{who} crouches to grab something off the ground with the {side} hand{how}",
        ],
        Action::WalkCircle => &[
            "{who} walks in a circle to the {side}{how}",
            "{who} is walking around in a {side} curve{how}",
            "{who} walks along a circle, turning {side}{how}",
        ],
        Action::Reach => &[
            "{who} reaches up with the {side} hand and takes something down, twice{how}",
            "{who} gets something from a high shelf with the {side} hand{how}",
            "{who} stretches the {side} arm upwards and brings it back to the chest{how}",
        ],
        Action::SideStep => &[
            "{who} steps sideways to the {side} and then back to the {other}{how}",
            "{who} shuffles to the {side} and returns{how}",
            "{who} side steps {side}, then {other}{how}",
        ],
        Action::Bow => &[
            "{who} bows{how} two times",
            "{who} bends forward at the waist in a bow and straightens up{how}",
            "{who} takes a bow{how}, then another one",
        ],
        Action::Talk => &[
            "{who} stands and talks{how}, gesturing with both hands",
            "{who} explains something with lively hands{how}",
            "{who} is having a conversation while moving the hands{how}",
        ],
        Action::Hop => &[
            "{who} hops forward with both feet{how}",
            "{who} jumps forward several times{how}",
            "{who} makes a series of jumps ahead{how}",
        ],
        Action::March => &[
            "{who} marches on the spot{how}",
            "{who} lifts the knees high while stepping in place{how}",
            "{who} marches in place, swinging the arms{how}",
        ],
        Action::WalkPhone => &[
            "{who} walks while holding a phone to the {side} ear{how}",
            "{who} is walking and talking on the phone{how}",
            "with the {side} hand at the ear, {who} walks ahead{how}",
        ],
        Action::WalkTurn => &[
            "{who} walks forward, turns around to the {side} and walks back{how}",
            "{who} walks ahead, makes a half turn and returns{how}",
            "{who} walks{how}, turns {side} and goes back",
        ],
    }
}

/// Phrases about single parts, if a part has a describable action. Each completes "The person is ... with
/// their <part>."
fn parts(action: Action, facts: Facts) -> Vec<(BodyPart, &'static str)> {
    use BodyPart::{BothArms, LeftArm, LowerBody, RightArm, UpperBody};
    let acting = match facts.side.sign() > 0.0 {
        true => LeftArm,
        false => RightArm,
    };
    match action {
        Action::Walk => vec![
            (LowerBody, "walking forward{how}"),
            (BothArms, "swinging as in walking{how}"),
        ],
        Action::WaveRight | Action::WaveLeft => vec![
            (acting, "waving{how}"),
            (UpperBody, "greeting with a wave{how}"),
            (LowerBody, "standing still{how}"),
        ],
        Action::Punch => vec![
            (UpperBody, "boxing{how}"),
            (BothArms, "punching{how}"),
            (LeftArm, "throwing jabs{how}"),
            (RightArm, "throwing cross punches{how}"),
            (LowerBody, "holding a fighting stance{how}"),
        ],
        Action::Sit => vec![
            (LowerBody, "sitting down and standing up{how}"),
            (BothArms, "reaching for the thighs{how}"),
            (UpperBody, "leaning forward to sit down and get up{how}"),
        ],
        Action::Run => vec![
            (LowerBody, "running{how}"),
            (BothArms, "pumping as in running{how}"),
        ],
        Action::Kick => vec![
            (LowerBody, "kicking forward{how}"),
            (BothArms, "keeping up a guard{how}"),
        ],
        Action::RaiseArms => vec![
            (BothArms, "reaching overhead{how}"),
            (UpperBody, "stretching upwards{how}"),
            (LeftArm, "reaching overhead{how}"),
            (RightArm, "reaching overhead{how}"),
            (LowerBody, "standing still{how}"),
        ],
        Action::WalkWave => vec![
            (acting, "waving{how}"),
            (LowerBody, "walking forward{how}"),
            (UpperBody, "greeting with a wave{how}"),
        ],
        Action::Squat => vec![
            (LowerBody, "squatting down and coming up{how}"),
            (BothArms, "reaching forward{how}"),
            (
                UpperBody,
                "leaning forward with the arms stretched out{how}",
            ),
        ],
        Action::Throw => vec![
            (acting, "throwing overarm{how}"),
            (UpperBody, "throwing a ball{how}"),
            (BothArms, "winding up and throwing{how}"),
            (LowerBody, "stepping forward into a throw{how}"),
        ],
        Action::WalkBackward => vec![
            (LowerBody, "walking backward{how}"),
            (BothArms, "swinging loosely{how}"),
        ],
        Action::Clap => vec![
            (BothArms, "clapping{how}"),
            (UpperBody, "applauding{how}"),
            (LowerBody, "standing still{how}"),
        ],
        Action::Jump => vec![
            (LowerBody, "jumping on the spot{how}"),
            (BothArms, "swinging up for a jump{how}"),
        ],
        Action::Turn => vec![(LowerBody, "turning {side} in place{how}")],
        Action::Jog => vec![
            (LowerBody, "jogging{how}"),
            (BothArms, "swinging with bent elbows{how}"),
        ],
        Action::PickUp => vec![
            (acting, "picking something up from the floor{how}"),
            (UpperBody, "bending down to pick something up{how}"),
            (LowerBody, "crouching down and standing up{how}"),
        ],
        Action::WalkCircle => vec![
            (LowerBody, "walking in a circle to the {side}{how}"),
            (BothArms, "swinging as in walking{how}"),
        ],
        Action::Reach => vec![
            (acting, "reaching up for something{how}"),
            (UpperBody, "reaching up to a high shelf{how}"),
            (LowerBody, "standing on tiptoe and coming down{how}"),
        ],
        Action::SideStep => vec![(LowerBody, "stepping sideways to the {side} and back{how}")],
        Action::Bow => vec![
            (UpperBody, "bowing{how}"),
            (BothArms, "staying close to the sides{how}"),
            (LowerBody, "standing still{how}"),
        ],
        Action::Talk => vec![
            (BothArms, "gesturing as in a conversation{how}"),
            (UpperBody, "talking and gesturing{how}"),
            (LeftArm, "gesturing{how}"),
            (RightArm, "gesturing{how}"),
            (LowerBody, "standing still{how}"),
        ],
        Action::Hop => vec![
            (LowerBody, "hopping forward{how}"),
            (BothArms, "swinging forward for a jump{how}"),
        ],
        Action::March => vec![
            (LowerBody, "marching in place{how}"),
            (BothArms, "swinging as in marching{how}"),
        ],
        Action::WalkPhone => vec![
            (acting, "holding a phone to the ear{how}"),
            (UpperBody, "talking on the phone{how}"),
            (LowerBody, "walking forward{how}"),
        ],
        Action::WalkTurn => vec![
            (LowerBody, "walking forward and back again{how}"),
            (BothArms, "swinging as in walking{how}"),
        ],
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;

    use super::*;
    use crate::gait::Side;
    use crate::style;

    #[test]
    fn every_clip_is_described_in_whole_and_in_parts() {
        let named = [
            "UPPER_BODY",
            "LOWER_BODY",
            "LEFT_ARM",
            "RIGHT_ARM",
            "BOTH_ARMS",
        ];
        for action in Action::ALL {
            for style in &style::ALL {
                for (side, count) in [(Side::Left, 2), (Side::Right, 3)] {
                    let facts = Facts { side, count };
                    let mut rng = Seed(1).rng(&[action.name(), style.name]);
                    let (captions, parts) = describe(action, style.name, facts, &mut rng);
                    assert!(CAPTIONS.contains(&captions.len()));
                    assert!(!parts.is_empty());
                    for caption in &captions {
                        let text = &caption.text;
                        assert!(!text.contains(['{', '}']) && !text.contains("  "), "{text}");
                        assert!(captions.iter().filter(|other| other.text == *text).count() == 1);
                    }
                    for part in &parts {
                        assert!(named.contains(&part.part.as_str()));
                        assert!(
                            part.text
                                .split(' ')
                                .next()
                                .expect("a word")
                                .ends_with("ing")
                        );
                        assert!(!part.text.contains(['{', '}']));
                    }
                }
            }
        }
    }

    #[test]
    fn the_side_that_acts_is_the_side_that_is_named() {
        let facts = Facts {
            side: Side::Left,
            count: 2,
        };
        let (captions, parts) = describe(
            Action::WaveLeft,
            "neutral",
            facts,
            &mut Seed(2).rng(&["text"]),
        );
        assert!(captions.iter().all(|caption| caption.text.contains("left")));
        assert!(
            parts
                .iter()
                .any(|part| part.part == "LEFT_ARM" && part.text == "waving")
        );
    }
}
