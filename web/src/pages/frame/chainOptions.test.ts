import { describe, expect, it } from 'vitest';
import type { ChainOption } from '../../api/types';
import { sliderOf, withChange } from './chainOptions';

const option = (name: string, kind: ChainOption['kind'], value: string): ChainOption => ({
  name,
  kind,
  value,
  source: '',
});

describe('constants of a chain', () => {
  it('have a slider around their value', () => {
    expect(sliderOf(option('min_area_px', 'integer', '6'))).toEqual({ min: 1, max: 24, step: 1 });
    expect(sliderOf(option('threshold_dn', 'number', '12'))).toEqual({ min: 1, max: 48, step: 1 });
    expect(sliderOf(option('threshold_dn', 'number', '0.5')).step).toBeCloseTo(0.01);
  });

  it('are changed only if they differ from the own value', () => {
    const options = [option('min_area_px', 'integer', '6')];
    const changed = withChange({}, options, 'min_area_px', '3');
    expect(changed).toEqual({ min_area_px: '3' });
    expect(withChange(changed, options, 'min_area_px', '6')).toEqual({});
    expect(withChange(changed, options, 'min_area_px', '')).toEqual({});
  });
});
