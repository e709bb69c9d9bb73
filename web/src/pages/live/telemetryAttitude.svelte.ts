/** The newest attitude in the sensor's telemetry, read through the roles of its dictionary. */
import { lampOf, type LampState } from '../../lib/lamp';
import { boresight, camFromIcrs } from '../../sky/reported';
import { current } from '../../state/current.svelte';
import { live } from '../../state/live.svelte';

class TelemetryAttitude {
  private readonly place = $derived(live.dictionary?.roles.attitude ?? null);
  private readonly values = $derived(live.values.filter((v) => v.packet === this.place?.packet));
  private readonly named = $derived(new Map(this.values.map((v) => [v.name, v])));
  private readonly first = $derived(this.values[0]);
  /** Time of the packet, ms; null before the first one. */
  readonly atMs = $derived(this.first?.at ? Date.parse(this.first.at) : null);
  /** False while the sensor reports no attitude; the values are then those of its last attitude. */
  readonly solved = $derived.by(() => {
    const outcome = this.place ? this.value(this.place.outcome) : undefined;
    return outcome === undefined || outcome === 'solved';
  });
  /** cam_from_icrs, scalar-last; null before the first attitude. */
  readonly quaternion = $derived.by(() => {
    const place = this.place;
    if (!place) return null;
    const numbers = place.quaternion.map((name) => this.value(name));
    return numbers.length === 4 && numbers.every((n) => typeof n === 'number')
      ? camFromIcrs(numbers as number[], place.order, place.rotation, place.cam_from_own)
      : null;
  });
  readonly angles = $derived(this.quaternion ? boresight(this.quaternion) : null);
  /** The state of the packet by its age in the dictionary, and by the freshness of the line. */
  readonly state: LampState = $derived(this.first ? current.lamp(lampOf(this.first.state), 'device') : 'never');

  private value(name: string): unknown {
    return (this.named.get(name) ?? this.named.get(`${this.place?.packet}.${name}`))?.value;
  }
}

export const telemetryAttitude = new TelemetryAttitude();
