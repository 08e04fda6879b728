// The messages of steering: velocities and targets, at frames that can still change.

export const WALK_MPS = 1.2;
export const RUN_MPS = 3.0;
// [frames, seconds]: the greater of the two counts
const USUAL_LEAD = [12, 0.6]; // from an edit to its first frame, until one has been measured
const COMMIT_MARGIN = [8, 0.4]; // what may be committed while a message is under way

/** The frame `seconds` from now, or the first one that a target can surely name. */
export function frameIn(member, seconds) {
  const { track, rig } = member;
  const wanted = Math.round(track.playhead() + seconds * rig.frameRate);
  return Math.max(wanted, track.committedTo + framesOf(COMMIT_MARGIN, rig), 0);
}

function framesOf([least, seconds], rig) {
  return Math.max(least, Math.round(seconds * rig.frameRate));
}

/** Frames that pass before an edit made now shows: as many as for the last one that was accepted. */
export function leadFrames(member) {
  const last = member.info.edits.find((edit) => edit.op !== "set_prompt" && edit.effective_frame !== null);
  return Math.max(last ? last.effective_frame - last.at_frame : 0, framesOf(USUAL_LEAD, member.rig));
}

/** The planned place of a member's root at a frame, as far as it is known: {x, z, y}. */
export function rootAt(member, frame) {
  const { track, rig } = member;
  const row = track.row(Math.min(Math.max(frame, track.first), track.end - 1));
  if (!row) return null;
  const at = rig.columns.root_translation_m[0];
  return { x: row[at], y: row[at + 1], z: row[at + 2] };
}

/** A constraint: walk to a place, however far, and be there as soon as a person can; the server says when. */
export function goTo(place) {
  return { kind: "waypoint", frame: 0, x_m: place.x, z_m: place.z, at_any_frame: true };
}

/** Walk along a drawn line. It is smoothed here; the server rounds its corners. points: [[x, z]]. */
export function pathAlong(points, mps = WALK_MPS) {
  return { kind: "path", corners_m: thinned(points), speed_mps: mps };
}

const TREMBLE_M = 0.08;

/** The significant points of a line: what is left out deviates no more than a hand trembles (Douglas-Peucker). */
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
