import { describe, expect, it } from 'vitest';
import { article, holders, lacking } from './roles';

describe('lacking', () => {
  it("names the required roles and the user's role", () => {
    expect(lacking('command.power', 'viewer')).toBe("commanding needs the operator's role, you are a viewer");
    expect(lacking('catalogues.build', 'engineer')).toBe(
      "building catalogues needs the catalogue manager's role, you are an engineer",
    );
    expect(lacking('frames.solve', 'viewer')).toContain("the operator's or engineer's role");
    expect(lacking('admin.users', 'operator')).toContain("the admin's role, you are an operator");
  });
  it('supports a group of commands that several roles share', () => {
    expect(holders('command.imager')).toEqual(['operator', 'engineer']);
    expect(holders('command.link')).toEqual(['operator']);
    expect(article('admin')).toBe('an admin');
  });
});
