// What steering says to a character: velocities and targets, with frames that can still change.

export const WALK_MPS = 1.2;
export const RUN_MPS = 3.0;
// at the least so many frames, and at higher rates so many seconds:
const USUAL_LEAD = [12, 0.6]; // from an edit to the first frame that shows it, where none has shown it yet
const COMMIT_MARGIN = [8, 0.4]; // what is committed while a message is under way

/** The frame `seconds` from now, or the first that a target may surely name. */
export function frameIn(member, seconds) {
  const { track, rig } = member;
  const wanted = Math.round(track.playhead() + seconds * rig.frameRate);
  return Math.max(wanted, track.committedTo + framesOf(COMMIT_MARGIN, rig), 0);
}

function framesOf([least, seconds], rig) {
  return Math.max(least, Math.round(seconds * rig.frameRate));
}

/** The frames that pass before an edit of now shows: those of the last one that was taken. */
export function leadFrames(member) {
  const last = member.info.edits.find((edit) => edit.op !== "set_prompt" && edit.effective_frame !== null);
  return Math.max(last ? last.effective_frame - last.at_frame : 0, framesOf(USUAL_LEAD, member.rig));
}

/** Where the root of a member is planned to be at a frame, as far as that is known: {x, z, y}. */
export function rootAt(member, frame) {
  const { track, rig } = member;
  const row = track.row(Math.min(Math.max(frame, track.first), track.end - 1));
  if (!row) return null;
  const at = rig.columns.root_translation_m[0];
  return { x: row[at], y: row[at + 1], z: row[at + 2] };
}

/** Walk to a place, however far, and be there as soon as a person can: the server says when. Returns the constraint. */
export function goTo(place) {
  return { kind: "waypoint", frame: 0, x_m: place.x, z_m: place.z, at_any_frame: true };
}

/** Walk along a drawn line, whose tremble is taken out here and whose corners the server cuts. points: [[x, z]]. */
export function pathAlong(points, mps = WALK_MPS) {
  return { kind: "path", corners_m: thinned(points), speed_mps: mps };
}

const TREMBLE_M = 0.08;

/** The points of a line that matter: between two that stay, none is further off than a hand trembles (Douglas-Peucker). */
export function thinned(points) {
  if (points.length < 3) return points;
  const [a, b] = [points[0], points[points.length - 1]];
  const [dx, dz] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dz);
  let [most, at] = [0, 0];
  for (let n = 1; n < points.length - 1; n++) {
    const [x, z] = [points[n][0] - a[0], points[n][1] - a[1]];
    const off = length > 1e-6 ? Math.abs(x * dz - z * dx) / length : Math.hypot(x, z);
    if (off > most) [most, at] = [off, n];
  }
  if (most <= TREMBLE_M) return [a, b];
  return [...thinned(points.slice(0, at + 1)).slice(0, -1), ...thinned(points.slice(at))];
}
