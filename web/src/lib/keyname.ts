/** The name of Command or Control with K on the user's keyboard. */
export function goToKey(platform: string): string {
  return /mac|iphone|ipad/i.test(platform) ? '⌘K' : 'Ctrl K';
}
