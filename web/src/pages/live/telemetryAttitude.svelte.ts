/** Latest attitude in the sensor's telemetry. The roles of the dictionary name its fields. */
import { lampOf, type LampState } from '../../lib/lamp';
import { boresight, camFromIcrs } from '../../sky/reported';
import { current } from '../../state/current.svelte';
import { live } from '../../state/live.svelte';

class TelemetryAttitude {
  private readonly role = $derived(live.dictionary?.roles.attitude ?? null);
  private readonly values = $derived(live.values.filter((v) => v.packet === this.role?.packet));
  private readonly byName = $derived(new Map(this.values.map((v) => [v.name, v])));
  private readonly first = $derived(this.values[0]);
  /** Time of the packet in milliseconds; null before the first packet. */
  readonly atMs = $derived(this.first?.at ? Date.parse(this.first.at) : null);
  /** False while the sensor reports no attitude. The values are then those of its last attitude. */
  readonly solved = $derived.by(() => {
    const outcome = this.role ? this.value(this.role.outcome) : undefined;
    return outcome === undefined || outcome === 'solved';
  });
  /** Quaternion cam_from_icrs, scalar-last; null before the first attitude. */
  readonly quaternion = $derived.by(() => {
    const role = this.role;
    if (!role) return null;
    const numbers = role.quaternion.map((name) => this.value(name));
    return numbers.length === 4 && numbers.every((n) => typeof n === 'number')
      ? camFromIcrs(numbers as number[], role.order, role.rotation, role.cam_from_own)
      : null;
  });
  readonly angles = $derived(this.quaternion ? boresight(this.quaternion) : null);
  /** State of the packet, from its permitted age in the dictionary and the freshness of the line. */
  readonly state: LampState = $derived(this.first ? current.lamp(lampOf(this.first.state), 'device') : 'never');

  private value(name: string): unknown {
    return (this.byName.get(name) ?? this.byName.get(`${this.role?.packet}.${name}`))?.value;
  }
}

export const telemetryAttitude = new TelemetryAttitude();
